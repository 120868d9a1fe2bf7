import { describe, expect, it } from "vitest";
import { filter } from "./search";

const AGENT = { name: "vehicle-07", role: "vehicle", runs: ["mqtt-bridge", "bag-player"], location: undefined };

describe("a search", () => {
  it("finds everything when nothing was typed", () => expect(filter("  ")(AGENT)).toBe(true));
  it("wants all words, anywhere, in any case", () => {
    expect(filter("VEHICLE bridge")(AGENT)).toBe(true);
    expect(filter("vehicle recorder")(AGENT)).toBe(false);
  });
  it("looks at one key when it is named", () => {
    expect(filter("runs:bag")(AGENT)).toBe(true);
    expect(filter("role:bridge")(AGENT)).toBe(false);
    expect(filter("location:x")(AGENT)).toBe(false);
  });
  it("takes a colon that names no key as text", () => {
    expect(filter("sha256:ab")({ digest: "sha256:abcd" })).toBe(true);
  });
});
