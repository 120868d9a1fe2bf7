/**
 * Sources that are away, each said in its row and in a view that shows what it carries: node sources.mjs URL
 * SOURCE=VIEW ...
 */
import assert from "node:assert/strict";
import { goTo, openPage, withBrowser } from "./pages.mjs";

const [url, ...pairs] = process.argv.slice(2);

await withBrowser(async (browser) => {
  const { page, complaints } = await openPage(browser, url);
  await page.getByText("live without").waitFor();
  for (const [source, view] of pairs.map((pair) => pair.split("="))) {
    await goTo(page, "sources", "Sources");
    const row = page.locator("tbody tr", { has: page.getByText(source, { exact: true }) });
    const words = await row.textContent();
    assert.match(words, /away/, `${source} is away`);
    assert.match(words, /cannot be reached: connection refused\. Look at/, `${source} says why and what to do`);
    await goTo(page, view, view[0].toUpperCase() + view.slice(1));
    await page.getByText(`${source}: away since`).waitFor();
  }
  assert.deepEqual(complaints, []);
});
console.log("each is said");
