/** Times, durations and counts in words, as every view says them. */

const MINUTE = 60;
const HOUR = 3600;
const DAY = 86400;

/** A duration: "40 ms", "1.2 s", "34 s", "3 min 20 s", "2 h 5 min", "3 d 4 h". */
export function duration(seconds: number): string {
  if (seconds < 0) return `−${duration(-seconds)}`;
  if (seconds < 0.9995) return `${Math.round(seconds * 1000)} ms`;
  if (seconds < 9.95) return `${seconds.toFixed(1)} s`;
  const whole = Math.round(seconds);
  if (whole < MINUTE) return `${whole} s`;
  if (whole < HOUR) return two(Math.floor(whole / MINUTE), "min", whole % MINUTE, "s");
  if (whole < DAY) return two(Math.floor(whole / HOUR), "h", Math.floor((whole % HOUR) / MINUTE), "min");
  return two(Math.floor(whole / DAY), "d", Math.floor((whole % DAY) / HOUR), "h");
}

function two(large: number, largeUnit: string, small: number, smallUnit: string): string {
  return small ? `${large} ${largeUnit} ${small} ${smallUnit}` : `${large} ${largeUnit}`;
}

/** The time of day of a time in milliseconds; with the date when that is another day than `now`. */
export function clock(time: number, now: number): string {
  const date = new Date(time);
  const hours = date.toLocaleTimeString("en-GB", { hour: "2-digit", minute: "2-digit", second: "2-digit" });
  return date.toDateString() === new Date(now).toDateString() ? hours : `${day(date)} ${hours}`;
}

function day(date: Date): string {
  return date.toLocaleDateString("en-GB", { day: "numeric", month: "short" });
}

/** How long something lasts until now, in whole seconds: it is looked at once a second. */
export function age(since: number, now: number): string {
  return duration(Math.max(0, Math.floor((now - since) / 1000)))
    .replace(/\.0 s$/, " s")
    .replace(/^0 ms$/, "0 s");
}

/** How long ago a time in milliseconds was: "just now", "34 s ago". */
export function ago(time: number, now: number): string {
  return now - time < 1000 ? "just now" : `${age(time, now)} ago`;
}

/** "1 agent", "3 agents"; `many` where the plural is no added s. */
export function count(number: number, one: string, many = `${one}s`): string {
  return `${number.toLocaleString("en-GB")} ${number === 1 ? one : many}`;
}

/** Bytes: "340 B", "1.2 MB". */
export function bytes(number: number): string {
  const units = ["B", "kB", "MB", "GB", "TB"];
  let value = number;
  let unit = 0;
  while (value >= 999.5 && unit < units.length - 1) {
    value /= 1000;
    unit += 1;
  }
  return `${unit && value < 9.95 ? value.toFixed(1) : Math.round(value)} ${units[unit]}`;
}

/** The first characters of a digest or commit, enough to know it by. */
export function short(digest: string): string {
  const [, hex] = /(?:sha256:)?([0-9a-f]{12})[0-9a-f]{20,}/.exec(digest) ?? [];
  return hex ?? digest;
}
