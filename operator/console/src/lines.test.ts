import { describe, expect, it } from "vitest";
import { difference } from "./lines";

const shown = (before: string | null, after: string | null): string[] =>
  difference(before, after).map(({ mark, text }) => mark + text);

describe("the difference of two texts", () => {
  it("has what went and came, with two lines around it", () => {
    expect(shown("a\nb\nc\nd\ne\n", "a\nb\nc\nx\ne\n")).toEqual([" b", " c", "-d", "+x", " e"]);
  });
  it("is the whole of a text that comes or goes", () => {
    expect(shown(null, "a\nb\n")).toEqual(["+a", "+b"]);
    expect(shown("a\n", null)).toEqual(["-a"]);
    expect(shown("a\n", "a\n")).toEqual([]);
  });
  it("is all of both where they are long", () => {
    const long = (word: string): string => Array.from({ length: 900 }, (_, index) => `${word}${index}`).join("\n");
    expect(shown(long("a"), long("b"))).toHaveLength(1800);
  });
});
