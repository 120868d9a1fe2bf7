/**
 * Figures of the page as a browser has it: node figures.mjs URL SECONDS [polled]. With `polled` the stream never says
 * anything, as behind a proxy that buffers, and the page polls around it.
 *
 * Prints one line of JSON: `first_paint_ms` since the address was gone to; `page_bytes` of documents, scripts and
 * styles, and `data_bytes` of the first snapshot, as they came over the wire; `frames` drawn of the map in each second;
 * `event_ms`, of each event that came while the page was open, from its beginning by the clock of who reports it until
 * the browser had drawn it.
 */
import { openPage, withBrowser } from "./pages.mjs";

const [url, seconds, way] = process.argv.slice(2);
// What is under way when a page opens is over then; and it has given up a stream that stayed mute twice.
const READY_MS = way === "polled" ? 30_000 : 5_000;

/** In the page, before its own scripts: notes each frame in which the map is drawn, and when an event is seen first. */
function observe() {
  const figures = { drawn: [], events: {} };
  window.figures = figures;
  const clear = CanvasRenderingContext2D.prototype.clearRect;
  let noted = -1;
  CanvasRenderingContext2D.prototype.clearRect = function (...area) {
    const frame = document.timeline.currentTime;
    if (frame !== noted) figures.drawn.push(performance.now());
    noted = frame;
    return clear.apply(this, area);
  };
  const seen = () => {
    const links = document.querySelectorAll("a[href*='/why/event/']");
    const fresh = [...links]
      .map((one) => one.getAttribute("href").split("/").at(-1))
      .filter((id) => !(id in figures.events));
    for (const id of fresh) figures.events[id] = null;
    if (!fresh.length) return;
    // The next frame draws what was changed before it; a message comes after that frame.
    requestAnimationFrame(() => {
      const { port1, port2 } = new MessageChannel();
      port1.onmessage = () => fresh.forEach((id) => (figures.events[id] = performance.timeOrigin + performance.now()));
      port2.postMessage(null);
    });
  };
  new MutationObserver(seen).observe(document, { childList: true, subtree: true });
}

await withBrowser(async (browser) => {
  const prepare = async (page) => {
    await page.addInitScript(observe);
    if (way === "polled") await page.route("**/api/events*", () => undefined);
  };
  const { page, complaints } = await openPage(browser, url, { prepare });
  await page.locator("canvas").first().waitFor();
  await page.waitForTimeout(READY_MS);
  const before = await page.evaluate(() => ({ at: performance.now(), events: Object.keys(window.figures.events) }));
  await page.waitForTimeout(Number(seconds) * 1000);
  const figures = await page.evaluate(async (from) => {
    const until = performance.now();
    const answer = await fetch("api/snapshot");
    const { items } = await answer.json();
    const known = new Set(from.events);
    const entries = performance.getEntriesByType("resource");
    const bytes = (some) => some.reduce((sum, one) => sum + one.transferSize, 0);
    const isData = (entry) => new URL(entry.name).pathname.includes("/api/");
    return {
      first_paint_ms: performance.getEntriesByName("first-contentful-paint")[0].startTime,
      page_bytes: bytes([...performance.getEntriesByType("navigation"), ...entries.filter((one) => !isData(one))]),
      data_bytes: bytes(entries.filter((one) => new URL(one.name).pathname.endsWith("/api/snapshot")).slice(0, 1)),
      frames: window.figures.drawn.filter((at) => at >= from.at && at < until).length / ((until - from.at) / 1000),
      event_ms: Object.entries(window.figures.events)
        .filter(([id, at]) => at !== null && !known.has(id) && items.events[id]?.began_ms)
        .map(([id, at]) => at - items.events[id].began_ms),
    };
  }, before);
  if (complaints.length) throw new Error(complaints.join("\n"));
  console.log(JSON.stringify(figures));
});
