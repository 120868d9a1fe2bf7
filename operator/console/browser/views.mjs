/**
 * Every view and state before the synthetic fleet: node views.mjs MODE URL [FOLDER]. Each view is looked at on a desk and
 * on a telephone, light and dark; nothing may complain or be wider than the window, and axe may find no violation.
 */
import assert from "node:assert/strict";
import axe from "axe-core";
import { goTo, tooWide, openPage, picture, withBrowser } from "./pages.mjs";

const [mode, url, folder] = process.argv.slice(2);

const VIEWS = [
  ["fleet", "agents"],
  ["fleet/vehicle-00", "vehicle-00"],
  ["tasks", "Tasks"],
  ["tasks/ask", "Ask for an application"],
  ["tasks/ask/pose-point-cloud-recording", "Ask for an application"],
  ["plans", "Plans"],
  ["recordings", "Recordings"],
  ["agents", "Agents"],
  ["catalogue", "Catalogue"],
  ["trust", "Trust"],
  ["sources", "Sources"],
  ["why/release/vehicle-00/mqtt-bridge", "within 400 m"],
];
const STATES = {
  live: VIEWS,
  reader: [["tasks/ask/pose-point-cloud-recording", "Ask for an application"]],
  buffered: [["fleet", "agents"]],
  empty: VIEWS.slice(0, 1).concat(VIEWS.slice(2, 4), VIEWS.slice(5, 11)),
  "signed-out": [["fleet", "Sign in to see the fleet"]],
  forbidden: [["fleet", "You may not read this"]],
  away: [["fleet", "The fleet"]],
};

/** What axe finds that somebody who cannot see, or point, is kept from: rule, how bad, and where. */
const violations = async (page) => {
  await page.evaluate(axe.source);
  const { violations } = await page.evaluate(() => window.axe.run(document, { resultTypes: ["violations"] }));
  return violations.flatMap(({ id, impact, nodes }) =>
    nodes.map(({ target, failureSummary }) => `${id} (${impact}): ${target}: ${failureSummary}`),
  );
};

async function look(browser, size, dark) {
  const { page, complaints } = await openPage(browser, url, { size, dark });
  for (const [place, heading] of STATES[mode]) {
    await goTo(page, place, heading);
    await page.waitForTimeout(150);
    const what = `${mode} ${place} ${size}`;
    assert.deepEqual(await tooWide(page), [], `${what}: wider than the window`);
    assert.deepEqual(await violations(page), [], `${what}: violations`);
    assert.equal(await page.locator("h1").count(), 1, `${what}: not one heading`);
    await picture(page, folder, `${mode}-${place.replaceAll("/", "_")}-${size}${dark ? "-dark" : ""}`);
  }
  assert.deepEqual(complaints, []);
  await page.context().close();
}

/** A picture without words is found: the check can fail. */
async function findsViolations(browser) {
  const { page } = await openPage(browser, url);
  await goTo(page, "agents", "Agents");
  await page.evaluate(() => document.querySelector("main").append(document.createElement("img")));
  const [found, ...more] = await violations(page);
  assert.match(found, /^image-alt \(critical\): img/);
  assert.deepEqual(more, []);
  await page.context().close();
}

/** Who shares a Node is said so, where its Nodes stand and beside the list of all. */
async function saysWhoShares(browser) {
  const { page, complaints } = await openPage(browser, url);
  const words = "shares Node vehicle-10 with vehicle-10, vehicle-12 (trial)";
  await goTo(page, "agents", "Agents");
  await page.getByText("Trial mode: 1 Node is several agents'").waitFor();
  assert.equal(await page.getByText(words).count(), 1);
  await goTo(page, "fleet/vehicle-11", "vehicle-11");
  await page.getByText(words).waitFor();
  await page.getByText("Trial mode: 1 Node is several agents'").waitFor();
  assert.deepEqual(complaints, []);
  await page.context().close();
}

/** A recording leads to its chain, to a layout and to a command, which can be copied. */
async function takesARecordingAlong(browser) {
  const { page, complaints } = await openPage(browser, url);
  await goTo(page, "recordings", "Recordings");
  const row = page.locator("tbody tr").first();
  const layout = row.getByRole("link", { name: "for Foxglove or Lichtblick" });
  assert.match(await layout.getAttribute("href"), /^api\/recordings\/cloud-0\/encounter-[^/]+\/layout$/);
  const command = await row.locator(".command code").textContent();
  assert.match(command, /^robotkube recording export encounter-\S+ \.\/encounter-\S+ --format mcap$/);
  await page.context().grantPermissions(["clipboard-read", "clipboard-write"]);
  await row.getByRole("button", { name: "Copy robotkube recording export" }).click();
  await row.getByText("copied", { exact: true }).waitFor();
  assert.equal(await page.evaluate(() => navigator.clipboard.readText()), command);
  await page.evaluate(() => (Clipboard.prototype.writeText = () => Promise.reject(new Error("no leave"))));
  await row.getByRole("button", { name: "Copy robotkube recording export" }).click();
  await row.getByText("selected: copy it by Ctrl+C").waitFor();
  assert.equal(await page.evaluate(() => getSelection().toString()), command);
  assert.match(await row.getByRole("link").first().getAttribute("href"), /^#\/why\/recording\/cloud-0\/encounter-/);
  assert.deepEqual(complaints, []);
  await page.context().close();
}

/** Who moves on before a view was painted is followed: here as soon as the form's choice is in the document. */
async function movesOnAtOnce(browser) {
  const { page, complaints } = await openPage(browser, `${url}#/tasks`);
  await page.getByRole("link", { name: "Ask for an application" }).waitFor();
  await page.evaluate(() => {
    new MutationObserver((_, observer) => {
      if (!document.querySelector("main.form select")) return;
      observer.disconnect();
      location.hash = "#/tasks/ask/pose-point-cloud-recording";
    }).observe(document.body, { childList: true, subtree: true });
    location.hash = "#/tasks/ask";
  });
  await page.getByLabel("vehicles", { exact: false }).waitFor();
  assert.deepEqual(complaints, []);
  await page.context().close();
}

/** By keyboard alone: choose an application, fill the form, see what would happen, submit. */
async function ask(browser) {
  const { page, complaints } = await openPage(browser, `${url}#/tasks/ask/pose-point-cloud-recording`);
  const submit = page.getByRole("button", { name: "Submit", exact: true });
  await submit.waitFor();
  assert.equal(await submit.isDisabled(), true, "before one has seen what would happen");
  await page.getByRole("button", { name: "See what would happen" }).click();
  await page.getByText("vehicles is missing.").waitFor();
  const vehicles = page.getByLabel("vehicles", { exact: false });
  await vehicles.focus();
  await page.keyboard.type("nobody");
  await page.keyboard.press("Enter");
  await page.getByText("did you mean vehicle-00?").waitFor();
  await vehicles.fill("vehicle-00, vehicle-01");
  await page.keyboard.press("Enter");
  await page.getByText("would be accepted").waitFor();
  await page.locator("summary").first().click();
  await picture(page, folder, "asked-desk");
  await submit.click();
  await page.waitForURL(/#\/why\/task\//);
  await goTo(page, "tasks/withdraw/cloud-0/meeting", "Withdraw cloud-0/meeting");
  await page.getByText("would be withdrawn").first().waitFor();
  await picture(page, folder, "withdraw-desk");
  assert.deepEqual(complaints, []);
}

await withBrowser(async (browser) => {
  await look(browser, "desk", false);
  await look(browser, "phone", true);
  if (mode === "live") await findsViolations(browser);
  if (mode === "live") await saysWhoShares(browser);
  if (mode === "live") await takesARecordingAlong(browser);
  if (mode === "live") await movesOnAtOnce(browser);
  if (mode === "live") await ask(browser);
});
console.log(`${mode}: as it should be`);
