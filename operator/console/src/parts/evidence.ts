/** Evidence and upgrades of chart versions, in words. */
import type { CatalogueEntry } from "../live/model";
import { count } from "../words";

type Finding = CatalogueEntry["findings"][number];

/** "passed, 12 checks, signed by key 9f3c2a10"; what failed by its names. */
export function findingWords(finding: Finding): string {
  if (!finding.signed_by) return "no result that a trusted key signed";
  const failed = finding.failed.length ? `, failed: ${finding.failed.join(", ")}` : "";
  const checks = `${count(finding.passed, "check")} passed${failed}`;
  return `${finding.result.toLowerCase()}, ${checks}, signed by key ${finding.signed_by}`;
}

/** The versions that a chart's version is upgraded to, by "name version". */
export function followersOf(entries: Iterable<CatalogueEntry>): ReadonlyMap<string, readonly string[]> {
  const followers = new Map<string, string[]>();
  for (const { kind, name, version, replaces, skips } of entries)
    for (const before of kind === "chart" ? new Set([replaces, ...skips].filter(Boolean)) : []) {
      const key = `${name} ${before}`;
      followers.set(key, [...(followers.get(key) ?? []), version]);
    }
  return followers;
}

/** The version of what a release runs, by its digest; empty where the catalogue has it no more. */
export function versionsByDigest(entries: Iterable<CatalogueEntry>): ReadonlyMap<string, string> {
  return new Map(
    [...entries].filter(({ digest, version }) => digest && version).map((one) => [one.digest, one.version]),
  );
}
