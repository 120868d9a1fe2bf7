/** Links in words: how often a bridge carries a message, and since when none came. */
import type { Link } from "../live/model";
import { age, clock, count } from "../words";
import type { Tone } from "./parts";

/** "10 Hz", "silent", "not known". */
export function linkRate(link: Link): string {
  if (link.direction === "") return "not carried";
  if (link.rate_hz === null) return "not known";
  return link.rate_hz === 0 ? "silent" : `${link.rate_hz.toLocaleString("en-GB")} Hz`;
}

export function linkTone(link: Link): Tone {
  if (link.direction === "") return "bad";
  if (link.rate_hz === null) return "quiet";
  return link.rate_hz === 0 ? "warn" : "good";
}

/** What there is to say besides: since when it is silent, how old messages are, who is there to send or to receive. */
export function linkWords(link: Link, now: number): string {
  const words = [link.problem];
  if (link.silent_since_ms !== null)
    words.push(`no message since ${clock(link.silent_since_ms, now)} (${age(link.silent_since_ms, now)})`);
  if (link.latency_ms !== null) words.push(`last message ${link.latency_ms} ms old when it came`);
  if (link.matched === 0) words.push(link.direction === "out" ? "nobody publishes it" : "nobody subscribes to it");
  if (link.rate_hz === null && !link.problem) words.push("a rate needs two readings");
  return words.filter(Boolean).join("; ");
}

/** The links of one agent in a line; empty when it has none. */
export function linksInWords(links: readonly Link[]): string {
  if (!links.length) return "";
  const carried = links.filter((link) => link.direction !== "");
  const silent = carried.filter((link) => link.rate_hz === 0).length;
  const unknown = carried.filter((link) => link.rate_hz === null).length;
  const hertz = carried.reduce((sum, link) => sum + (link.rate_hz ?? 0), 0);
  const words = [count(carried.length, "link")];
  if (hertz) words.push(`${Number(hertz.toPrecision(2)).toLocaleString("en-GB")} messages/s`);
  if (silent) words.push(`${silent} silent`);
  if (unknown) words.push(`${unknown} not known`);
  if (carried.length < links.length) words.push(`${links.length - carried.length} not carried`);
  return words.join(", ");
}

/** Argo CD's page of an Application, by the address of its pages; empty where nobody gave one. */
export const argocdPage = (pages: string, application: string): string =>
  pages && `${pages.replace(/\/+$/, "")}/applications/${encodeURIComponent(application)}`;

/** The forge's page of the policies on main, by the address of any pull request of that repository, or of the forge. */
export function policiesPage(requests: Iterable<string>, forge: string): string {
  for (const request of requests) {
    const [repository, number] = request.split("/pulls/");
    if (repository && number) return `${repository}/src/branch/main/policies`;
  }
  return forge;
}
