/**
 * A plan's pull request on the forge's pages, as an account sees it that may see no more: node plan.mjs URL NAME PASSWORD
 * NUMBER [FOLDER]. What is to be read there comes as JSON, a line; scripts that failed, and files that could not be had,
 * are among it.
 */
import { openPage, picture, withBrowser } from "./pages.mjs";

const [url, name, password, number, folder] = process.argv.slice(2);
const repository = `${url}/robotkube/deployment`;

const texts = (page, selector) => page.locator(selector).allInnerTexts();

await withBrowser(async (browser) => {
  const failures = [];
  const prepare = async (page) => {
    page.on("response", (answer) => {
      if (answer.status() >= 400) failures.push(`${answer.status()} ${answer.url()}`);
    });
  };
  const { page, complaints } = await openPage(browser, `${url}/user/login`, { prepare });
  await page.locator("form.form input[name=user_name]").fill(name);
  await page.locator("form.form input[name=password]").fill(password);
  await Promise.all([
    page.waitForURL((address) => !address.pathname.endsWith("/user/login")),
    page.locator("form.form input[name=password]").press("Enter"),
  ]);

  await page.goto(`${repository}/pulls/${number}`, { waitUntil: "load" });
  await picture(page, folder, "pull-request");
  const request = {
    words: await page.locator("body").innerText(),
    headings: (await texts(page, ".render-content h2")).map((heading) => heading.trim()),
    lines: await texts(page, ".render-content li"),
  };

  await page.goto(`${repository}/pulls/${number}/files`, { waitUntil: "load" });
  await picture(page, folder, "pull-request-files");
  const files = await page.locator("body").innerText();

  await page.goto(`${repository}/pulls`, { waitUntil: "load" });
  await picture(page, folder, "pull-requests");
  const rules = await page.evaluate(() => [...document.styleSheets].map((sheet) => sheet.cssRules.length));
  const drawings = await page.locator("svg").count();

  // What the forge's scripts write on the console is theirs: its worker complains whenever one moves on.
  const errors = complaints.filter((complaint) => complaint.startsWith("error: "));
  console.log(JSON.stringify({ request, files, rules, drawings, failures: [...failures, ...errors] }));
});
