/** Browsers of the tests: Debian's Chromium, one page at a time, which collects what went wrong in it. */
import { mkdir } from "node:fs/promises";
import { chromium } from "playwright-core";

export const SIZES = { desk: { width: 1280, height: 900 }, phone: { width: 390, height: 844 } };

const PROGRAM = process.env.ROBOTKUBE_CHROMIUM ?? "/usr/bin/chromium";
const SECONDS_MAX = 15;

/** A browser, closed when `use` has ended. */
export async function withBrowser(use) {
  const browser = await chromium.launch({ executablePath: PROGRAM, args: ["--no-sandbox", "--disable-gpu"] });
  try {
    return await use(browser);
  } finally {
    await browser.close();
  }
}

/**
 * A page of the console at `url`, which `prepare` has before it goes there; what it complains of stands in `complaints`.
 * With `anyAuthority` servers' certificates may be of anybody.
 */
export async function openPage(
  browser,
  url,
  { size = "desk", dark = false, anyAuthority = false, prepare = async () => {} } = {},
) {
  const context = await browser.newContext({
    viewport: SIZES[size],
    colorScheme: dark ? "dark" : "light",
    ignoreHTTPSErrors: anyAuthority,
  });
  const page = await context.newPage();
  page.setDefaultTimeout(SECONDS_MAX * 1000);
  const complaints = [];
  page.on("pageerror", (error) => complaints.push(`error: ${error.message}`));
  page.on("console", (message) => {
    const refused = message.text().startsWith("Failed to load resource");
    // What a browser says of a header that counts by HTTPS alone, where the page comes by HTTP.
    const byHttp = message.text().startsWith("The Cross-Origin-Opener-Policy header has been ignored");
    if (message.type() === "error" && !refused && !byHttp) complaints.push(`console: ${message.text()}`);
  });
  await prepare(page);
  await page.goto(url);
  return { page, complaints };
}

/** Go to a place of the page (`tasks/ask`), and wait for its heading. */
export async function goTo(page, place, heading) {
  await page.evaluate((hash) => (location.hash = hash), `#/${place}`);
  await page.getByRole("heading", { name: heading, exact: false }).first().waitFor();
}

/** What reaches beyond the window's right edge, where the page then scrolls sideways. */
export const tooWide = (page) =>
  page.evaluate(() => {
    const { clientWidth, scrollWidth } = document.documentElement;
    if (scrollWidth <= clientWidth) return [];
    const beyond = [...document.querySelectorAll("body *")].filter(
      (one) => one.getBoundingClientRect().right > clientWidth + 1,
    );
    return [`${scrollWidth} px`, ...beyond.map((one) => one.outerHTML.slice(0, 150))];
  });

/** A picture into a folder, where one is named. */
export async function picture(page, folder, name) {
  if (!folder) return;
  await mkdir(folder, { recursive: true });
  await page.screenshot({ path: `${folder}/${name}.png`, fullPage: true });
}
