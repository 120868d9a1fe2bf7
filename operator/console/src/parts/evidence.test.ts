import { describe, expect, it } from "vitest";
import type { CatalogueEntry } from "../live/model";
import { findingWords, followersOf, versionsByDigest } from "./evidence";

const entry = (version: string, more: Partial<CatalogueEntry> = {}): CatalogueEntry => ({
  ...{ kind: "chart", name: "bridge", version, state: "verified", description: "", provides: [], parameters: {} },
  ...{ digest: `sha256:${version}`, evidence: "", evidence_problem: "", channel: "stable", policy: "" },
  ...{ replaces: "", skips: [], findings: [], releases: [] },
  ...more,
});

describe("evidence in words", () => {
  it("says what a suite found and who signed it", () => {
    const passed = { suite: "static", result: "PASSED", passed: 12, failed: [], signed_by: "9f3c" };
    expect(findingWords(passed)).toBe("passed, 12 checks passed, signed by key 9f3c");
    const failed = { ...passed, result: "FAILED", failed: ["starts", "stops"] };
    expect(findingWords(failed)).toBe("failed, 12 checks passed, failed: starts, stops, signed by key 9f3c");
  });
  it("never says passed where nobody signed", () => {
    const unsigned = { suite: "static", result: "none", passed: 0, failed: [], signed_by: "" };
    expect(findingWords(unsigned)).toBe("no result that a trusted key signed");
  });
});

describe("upgrades", () => {
  it("lead from what is replaced or skipped to what follows, of the same chart", () => {
    const newest = entry("3", { replaces: "2", skips: ["1"] });
    const followers = followersOf([entry("1"), entry("2", { replaces: "1" }), newest, entry("1", { name: "other" })]);
    expect([...followers]).toEqual([
      ["bridge 1", ["2", "3"]],
      ["bridge 2", ["3"]],
    ]);
  });
  it("are known by the digest that runs", () => {
    const application = entry("", { kind: "application", digest: "sha256:a" });
    expect([...versionsByDigest([entry("3"), application])]).toEqual([["sha256:3", "3"]]);
  });
});
