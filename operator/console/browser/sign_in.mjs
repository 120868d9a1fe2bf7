/**
 * A person signs in at the console by the forge: node sign_in.mjs URL NAME PASSWORD GRANTED [FOLDER]. GRANTED: true, and
 * the person reads; false, and the console says what the provider said.
 */
import assert from "node:assert/strict";
import { openPage, picture, withBrowser } from "./pages.mjs";

const [url, name, password, granted, folder] = process.argv.slice(2);

await withBrowser(async (browser) => {
  // The forge's authority is the platform's own, which a person has told their browser of.
  const { page, complaints } = await openPage(browser, url, { anyAuthority: true });

  await page.getByRole("heading", { name: "Sign in to see the fleet" }).waitFor();
  await picture(page, folder, "signed-out");
  await page.getByRole("link", { name: "Sign in" }).click();

  await page.locator("input[name=user_name]").fill(name);
  await page.locator("input[name=password]").fill(password);
  await picture(page, folder, "forge-sign-in");
  await page.locator("input[name=password]").press("Enter");
  await page.locator(`button[name=granted][value=${granted}]`).waitFor();
  await picture(page, folder, "forge-grant");
  await page.locator(`button[name=granted][value=${granted}]`).click();
  await page.waitForURL((address) => address.href.startsWith(url));
  complaints.length = 0; // of the forge's pages

  if (granted === "false") {
    assert.ok((await page.locator("body").textContent()).includes("The provider says: the request is denied"));
    console.log("not signed in, as it should be");
    return;
  }
  await page.getByText("live", { exact: true }).waitFor();
  await page.getByText(name).first().waitFor();
  await picture(page, folder, "signed-in");
  await page.getByRole("button", { name: "Sign out" }).click();
  await page.getByRole("heading", { name: "Sign in to see the fleet" }).waitFor();
  assert.deepEqual(complaints, []);
  console.log(`${name} signed in, read, and signed out`);
});
