import { describe, expect, it } from "vitest";
import { scaleOf } from "./scale";

describe("a scale of time", () => {
  it("is linear where no pause is long", () => {
    const { position, cuts } = scaleOf([
      { from: 1000, to: 1400 },
      { from: 1500, to: 2000 },
    ]);
    expect([1000, 1500, 2000].map(position)).toEqual([0, 0.5, 1]);
    expect(cuts).toEqual([]);
  });

  it("cuts a long pause and says how long it was", () => {
    const { position, cuts } = scaleOf([
      { from: 0, to: 1000 },
      { from: 121_000, to: 122_000 },
    ]);
    expect(cuts.map((cut) => cut.milliseconds)).toEqual([120_000]);
    expect(position(1000)).toBeCloseTo(0.48, 1);
    expect(position(122_000)).toBe(1);
    expect(cuts[0]?.at).toBeCloseTo(0.5);
  });

  it("never goes backwards, and stays within its width", () => {
    const { position } = scaleOf([
      { from: 0, to: 30 },
      { from: 20, to: 50 },
      { from: 900, to: 900 },
      { from: 5000, to: 5100 },
    ]);
    const positions = Array.from({ length: 600 }, (_, index) => position(index * 10 - 100));
    expect([...positions].sort((one, other) => one - other)).toEqual(positions);
    expect([positions[0], positions.at(-1)]).toEqual([0, 1]);
  });

  it("does with moments alone, and with nothing", () => {
    const moments = scaleOf([
      { from: 5, to: 5 },
      { from: 10, to: 10 },
    ]);
    expect([moments.position(5), moments.position(10)]).toEqual([0, 1]);
    expect(scaleOf([]).position(7)).toBe(0);
  });
});
