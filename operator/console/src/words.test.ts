import { describe, expect, it } from "vitest";
import { age, ago, bytes, count, duration, short } from "./words";

describe("words", () => {
  it("say durations with the unit that fits", () => {
    const said = [0.04, 0.9999, 1.24, 9.96, 59.7, 200, 7500, 273600, -3].map(duration);
    expect(said).toEqual(["40 ms", "1.0 s", "1.2 s", "10 s", "1 min", "3 min 20 s", "2 h 5 min", "3 d 4 h", "−3.0 s"]);
  });

  it("say how long ago a time was", () => {
    expect([ago(99_500, 100_000), ago(97_000, 100_000), ago(66_000, 100_000)]).toEqual([
      "just now",
      "3 s ago",
      "34 s ago",
    ]);
  });

  it("say how long something lasts, without parts of seconds", () => {
    expect([age(99_500, 100_000), age(95_600, 100_000), age(200, 100)]).toEqual(["0 s", "4 s", "0 s"]);
  });

  it("say counts and sizes", () => {
    expect([count(1, "agent"), count(1200, "agent"), count(2, "entry", "entries")]).toEqual([
      "1 agent",
      "1,200 agents",
      "2 entries",
    ]);
    expect([999, 1234, 45678901, 999999].map(bytes)).toEqual(["999 B", "1.2 kB", "46 MB", "1.0 MB"]);
  });

  it("shorten digests and leave names alone", () => {
    expect(short(`sha256:${"0123456789abcdef".repeat(4)}`)).toBe("0123456789ab");
    expect(short("0.3.1")).toBe("0.3.1");
  });
});
