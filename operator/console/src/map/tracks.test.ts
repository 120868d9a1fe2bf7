import { describe, expect, it } from "vitest";
import { Track, TRAIL_MS, turned } from "./tracks";

const sample = (time: number, x = time, heading: number | null = 0) => ({ time, x, y: 2 * x, heading });

function track(...times: number[]): Track {
  const made = new Track();
  for (const time of times) made.add(sample(time));
  return made;
}

describe("a track", () => {
  it("has places between its samples", () => {
    expect(track(1000, 1500, 2000).at(1750)).toMatchObject({ x: 1750, y: 3500 });
  });

  it("stays where it was heard last, and where it was heard first", () => {
    expect(track(1000, 1500).at(60000)).toMatchObject({ x: 1500 });
    expect(track(1000, 1500).at(1)).toMatchObject({ x: 1000 });
    expect(track().at(1)).toBeUndefined();
  });

  it("draws no way through a gap", () => {
    expect(track(1000, 11000).at(10900)).toMatchObject({ x: 1000 });
  });

  it("drops what it heard before", () => {
    const made = track(10, 11);
    expect([made.add(sample(11, 99)), made.add(sample(9)), made.samples.length]).toEqual([false, false, 2]);
  });

  it("forgets what is older than its trail, and is bounded", () => {
    const made = track(...Array.from({ length: 100 }, (_, index) => 500 * index));
    expect(made.samples[0]?.time).toBe(500 * 99 - TRAIL_MS);
    const dense = track(...Array.from({ length: 1000 }, (_, index) => index));
    expect(dense.samples.length).toBe(120);
  });

  it("turns by the shorter way", () => {
    expect(turned(3, -3, 0.5)).toBeCloseTo(Math.PI);
    expect(turned(-3, 3, 0.5)).toBeCloseTo(-Math.PI);
    expect([turned(null, 1, 0.5), turned(1, null, 0.5)]).toEqual([1, 1]);
  });
});
