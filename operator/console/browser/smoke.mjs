/**
 * A way through fleet, why and tasks of a console where everybody reads: node smoke.mjs URL AGENT APPLICATION
 * PARAMETER=VALUE [FOLDER].
 */
import assert from "node:assert/strict";
import { goTo, openPage, picture, withBrowser } from "./pages.mjs";

const [url, agent, application, parameter, folder] = process.argv.slice(2);
const [name, value] = parameter.split("=");

await withBrowser(async (browser) => {
  const { page, complaints } = await openPage(browser, url);

  await page.getByText("live", { exact: true }).waitFor();
  // Events name agents, too.
  await page
    .getByRole("region", { name: /agents?$/ })
    .getByRole("link", { name: agent })
    .first()
    .click();
  await page.getByRole("heading", { name: agent, exact: true }).waitFor();
  await page.getByRole("heading", { name: "Links to the broker" }).waitFor();
  await page
    .getByText(/ Hz$|^silent$|^not known$/)
    .first()
    .waitFor();
  await picture(page, folder, "fleet");

  const release = page.locator(".runs a[href*='/why/release/']").first();
  const words = await release.textContent();
  await release.click();
  await page.locator(".chain > li").first().waitFor();
  assert.ok((await page.locator("main").textContent()).includes(words.trim()), `the chain of ${words} names it`);
  await picture(page, folder, "why");

  await goTo(page, "plans", "Plans");
  await page.locator("tbody tr").first().waitFor();
  await goTo(page, "recordings", "Recordings");
  await picture(page, folder, "recordings");
  const layout = page.getByRole("link", { name: "for Foxglove or Lichtblick" }).first();
  if (await layout.count()) {
    const [file] = await Promise.all([page.waitForEvent("download"), layout.click()]);
    console.log(`${file.suggestedFilename()} came`);
  }

  await page.getByRole("navigation").getByRole("link", { name: "Tasks" }).click();
  await page.getByRole("link", { name: "Ask for an application" }).click();
  await page.getByLabel("Application").selectOption(application);
  await page.getByRole("textbox", { name }).first().fill(value);
  await page.getByRole("button", { name: "See what would happen" }).click();
  await page.getByRole("heading", { name: "What would happen" }).waitFor();
  assert.equal(
    await page.getByRole("button", { name: "Submit", exact: true }).count(),
    0,
    "nobody signs in, so nobody submits",
  );
  await page.getByText("You cannot submit here.").waitFor();
  await picture(page, folder, "tasks");

  assert.deepEqual(complaints, []);
});
console.log("fleet, why and tasks are as they should be");
