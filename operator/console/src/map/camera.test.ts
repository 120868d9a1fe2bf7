import { describe, expect, it } from "vitest";
import { boundsOf, dragged, fitted, lengthInWords, roundLength, toScreen, toWorld, zoomed } from "./camera";

const SIZE = { width: 800, height: 600 };
const CAMERA = { x: 100, y: -50, scale: 4 };

describe("the camera", () => {
  it("goes from world to screen and back", () => {
    const point = { x: 130, y: -20 };
    expect(toScreen(CAMERA, SIZE, point)).toEqual({ x: 520, y: 180 });
    expect(toWorld(CAMERA, SIZE, { x: 520, y: 180 })).toEqual(point);
  });

  it("keeps what is below the pointer where it is", () => {
    const pivot = { x: 123, y: 456 };
    const before = toWorld(CAMERA, SIZE, pivot);
    const after = toWorld(zoomed(CAMERA, SIZE, pivot, 1.7), SIZE, pivot);
    expect(after.x).toBeCloseTo(before.x);
    expect(after.y).toBeCloseTo(before.y);
  });

  it("follows the hand", () => {
    const point = { x: 3, y: 4 };
    const before = toScreen(CAMERA, SIZE, point);
    expect(toScreen(dragged(CAMERA, 10, -6), SIZE, point)).toEqual({ x: before.x + 10, y: before.y - 6 });
  });

  it("shows all points inside of its margin", () => {
    const points = [
      { x: -500, y: 0 },
      { x: 700, y: 90 },
    ];
    const bounds = boundsOf(points);
    expect(bounds).toBeDefined();
    const camera = fitted(bounds as NonNullable<typeof bounds>, SIZE);
    for (const point of points) {
      const { x, y } = toScreen(camera, SIZE, point);
      expect(x).toBeGreaterThanOrEqual(47);
      expect(x).toBeLessThanOrEqual(753);
      expect(y).toBeGreaterThan(0);
    }
    expect(boundsOf([])).toBeUndefined();
  });

  it("has a scale bar of a round length", () => {
    expect(roundLength(CAMERA, 100)).toBe(20);
    expect(roundLength({ ...CAMERA, scale: 0.03 }, 100)).toBe(2000);
    expect([0.5, 20, 2000].map(lengthInWords)).toEqual(["50 cm", "20 m", "2 km"]);
  });
});
