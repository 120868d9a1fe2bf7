/** Where the map looks: the point of the world in its middle, in metres, and how many pixels a metre has. */
export interface Camera {
  readonly x: number;
  readonly y: number;
  readonly scale: number;
}

export interface Point {
  readonly x: number;
  readonly y: number;
}

export interface Size {
  readonly width: number;
  readonly height: number;
}

export interface Bounds {
  readonly left: number;
  readonly right: number;
  readonly bottom: number;
  readonly top: number;
}

export const SCALE_MIN = 0.002;
export const SCALE_MAX = 80;
const MARGIN_PIXELS = 48;
const SPAN_MIN_METRES = 20;

/** A point of the world on the screen; the world's y points up, the screen's down. */
export function toScreen(camera: Camera, size: Size, point: Point): Point {
  return {
    x: size.width / 2 + (point.x - camera.x) * camera.scale,
    y: size.height / 2 - (point.y - camera.y) * camera.scale,
  };
}

/** A point of the screen in the world. */
export function toWorld(camera: Camera, size: Size, point: Point): Point {
  return {
    x: camera.x + (point.x - size.width / 2) / camera.scale,
    y: camera.y - (point.y - size.height / 2) / camera.scale,
  };
}

/** Whether a point of the screen is on the map. */
export function within({ x, y }: Point, { width, height }: Size): boolean {
  return x >= 0 && y >= 0 && x <= width && y <= height;
}

/** The camera after zooming by a factor, with the point of the world below `pivot` where it was. */
export function zoomed(camera: Camera, size: Size, pivot: Point, factor: number): Camera {
  const scale = Math.min(SCALE_MAX, Math.max(SCALE_MIN, camera.scale * factor));
  const fixed = toWorld(camera, size, pivot);
  return {
    x: fixed.x - (pivot.x - size.width / 2) / scale,
    y: fixed.y + (pivot.y - size.height / 2) / scale,
    scale,
  };
}

/** The camera after dragging the map by so many pixels. */
export function dragged(camera: Camera, dx: number, dy: number): Camera {
  return { ...camera, x: camera.x - dx / camera.scale, y: camera.y + dy / camera.scale };
}

/** The bounds of points, or undefined where there are none. */
export function boundsOf(points: Iterable<Point>): Bounds | undefined {
  let left = Infinity;
  let right = -Infinity;
  let bottom = Infinity;
  let top = -Infinity;
  for (const { x, y } of points) {
    left = Math.min(left, x);
    right = Math.max(right, x);
    bottom = Math.min(bottom, y);
    top = Math.max(top, y);
  }
  return left <= right ? { left, right, bottom, top } : undefined;
}

/** The camera that shows `bounds` whole, with a margin, never nearer than 20 m. */
export function fitted(bounds: Bounds, size: Size): Camera {
  const width = Math.max(SPAN_MIN_METRES, bounds.right - bounds.left);
  const height = Math.max(SPAN_MIN_METRES, bounds.top - bounds.bottom);
  const room = (pixels: number): number => Math.max(1, pixels - 2 * MARGIN_PIXELS);
  const scale = Math.min(room(size.width) / width, room(size.height) / height);
  return {
    x: (bounds.left + bounds.right) / 2,
    y: (bounds.bottom + bounds.top) / 2,
    scale: Math.min(SCALE_MAX, Math.max(SCALE_MIN, scale)),
  };
}

/** A round length in metres (1, 2 or 5 times a power of ten) that has about `pixels` pixels. */
export function roundLength(camera: Camera, pixels: number): number {
  const wanted = pixels / camera.scale;
  const power = 10 ** Math.floor(Math.log10(wanted));
  const factor = [5, 2, 1].find((step) => step * power <= wanted) ?? 1;
  return factor * power;
}

/** A length in words: "50 m", "2 km". */
export function lengthInWords(metres: number): string {
  return metres >= 1000 ? `${metres / 1000} km` : metres >= 1 ? `${metres} m` : `${Math.round(metres * 100)} cm`;
}
