import { useEffect, useRef } from "preact/hooks";
import { live, tracks } from "../state";
import { count } from "../words";
import { dragged, fitted, toScreen, toWorld, within, zoomed, type Camera, type Point, type Size } from "./camera";
import { Drawing, MANY, themeOf, TRAILS_EACH_FRAME_MAX, type Theme } from "./drawing";
import { BEHIND_MS, nearest, sceneAt, sceneBounds, type Drawn, type Scene } from "./scene";

interface Properties {
  readonly found: ReadonlySet<string> | undefined;
  readonly selected: string | undefined;
  readonly select: (name: string | undefined) => void;
  /** Whether there is nothing to be drawn. */
  readonly empty: boolean;
}

/** 60 frames a second, and 30 with many agents: the page is open all day. */
const FRAME_MS_MIN = { few: 12, many: 28 };
const GROUND_MS = 500;
const REACH_PIXELS = 18;
const KEY_PIXELS = 60;
const KEY_ZOOM = 1.4;
const CLICK_PIXELS = 5;

/** The map of the fleet from above. What it shows is in the list beside it, too, for those who do not see it. */
export function FleetMap(properties: Properties) {
  const frame = useRef<HTMLDivElement>(null);
  const shown = useRef<Viewer>(undefined);
  const latest = useRef(properties);
  latest.current = properties;
  useEffect(() => {
    const viewer = new Viewer(frame.current as HTMLDivElement, () => latest.current);
    shown.current = viewer;
    return () => viewer.end();
  }, []);
  return (
    <div class="map" ref={frame}>
      <canvas />
      <canvas
        tabIndex={0}
        role="img"
        aria-label={`Map of ${count(tracks.size, "agent")}. Arrow keys move it, plus and minus zoom, 0 shows everything.`}
        data-map
      />
      {properties.empty && <p class="nothing">No position has been heard yet.</p>}
      <div class="tools">
        <button type="button" aria-label="Zoom in" onClick={() => shown.current?.zoom(KEY_ZOOM)}>
          +
        </button>
        <button type="button" aria-label="Zoom out" onClick={() => shown.current?.zoom(1 / KEY_ZOOM)}>
          −
        </button>
        <button type="button" aria-label="Show everything" onClick={() => shown.current?.fit()}>
          ⤢
        </button>
      </div>
    </div>
  );
}

const behind = (): number => (live.connection.mode === "polling" ? BEHIND_MS.polling : BEHIND_MS.live);

/** Draws the two layers of the map, frame by frame, and moves its camera as the hand says. */
class Viewer {
  private camera: Camera | undefined;
  private size: Size = { width: 0, height: 0 };
  private theme: Theme;
  private groundDrawn = 0;
  private drawn = 0;
  private request = 0;
  private readonly pointers = new Map<number, Point>();
  private wandered = 0;
  private shown: string | undefined;
  private readonly ended = new AbortController();
  private readonly layers: CanvasRenderingContext2D[];
  private readonly observer: ResizeObserver;

  constructor(
    private readonly frame: HTMLElement,
    private readonly properties: () => Properties,
  ) {
    const canvases = [...frame.querySelectorAll("canvas")];
    this.layers = canvases.map((canvas) => canvas.getContext("2d") as CanvasRenderingContext2D);
    this.theme = themeOf(frame);
    this.observer = new ResizeObserver(() => this.resized());
    this.observer.observe(frame);
    this.listen(canvases.at(-1) as HTMLCanvasElement);
    this.request = requestAnimationFrame(this.turn);
  }

  end(): void {
    this.ended.abort();
    this.observer.disconnect();
    cancelAnimationFrame(this.request);
  }

  zoom(factor: number, pivot: Point = { x: this.size.width / 2, y: this.size.height / 2 }): void {
    if (this.camera) this.look(zoomed(this.camera, this.size, pivot, factor));
  }

  fit(): void {
    const bounds = sceneBounds(this.scene(live.now()));
    if (bounds) this.look(fitted(bounds, this.size));
  }

  /** Move to an agent that was selected elsewhere and lies out of sight. */
  private show(selected: Drawn | undefined): void {
    const { camera, size } = this;
    if (selected?.name === this.shown || !camera) return;
    this.shown = selected?.name;
    if (selected && !within(toScreen(camera, size, selected.place), size))
      this.look({ ...camera, x: selected.place.x, y: selected.place.y });
  }

  private look(camera: Camera): void {
    this.camera = camera;
    this.groundDrawn = 0;
  }

  private scene(now: number): Scene {
    const { agents, poses, events, rules } = live.table.maps;
    const { found, selected } = this.properties();
    const shown = { found, selected, behind: behind() };
    return sceneAt({ tracks, agents, poses, events: events.values(), rules: rules.values(), ...shown }, now);
  }

  private readonly turn = (time: number): void => {
    this.request = requestAnimationFrame(this.turn);
    const least = tracks.size > MANY ? FRAME_MS_MIN.many : FRAME_MS_MIN.few;
    if (time - this.drawn < least || !this.size.width) return;
    this.drawn = time;
    if (!this.camera) this.fit();
    if (!this.camera) return;
    const now = live.now();
    const scene = this.scene(now);
    this.show(scene.selected);
    const [ground, moving] = this.layers.map(
      (layer) => new Drawing(layer, this.size, this.camera as Camera, this.theme, now - behind()),
    );
    if (scene.agents.length <= TRAILS_EACH_FRAME_MAX || time - this.groundDrawn > GROUND_MS) {
      ground?.ground(scene);
      this.groundDrawn = time;
    }
    moving?.moving(scene);
  };

  private resized(): void {
    const { width, height } = this.frame.getBoundingClientRect();
    this.size = { width, height };
    for (const layer of this.layers) {
      layer.canvas.width = Math.round(width * devicePixelRatio);
      layer.canvas.height = Math.round(height * devicePixelRatio);
      layer.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    }
    this.groundDrawn = 0;
  }

  private listen(canvas: HTMLCanvasElement): void {
    const { signal } = this.ended;
    canvas.addEventListener("pointerdown", (event) => this.pressed(canvas, event), { signal });
    canvas.addEventListener("pointermove", (event) => this.moved(event), { signal });
    for (const end of ["pointerup", "pointercancel"] as const)
      canvas.addEventListener(end, (event) => this.released(event), { signal });
    canvas.addEventListener("wheel", (event) => this.rolled(event), { signal, passive: false });
    canvas.addEventListener("keydown", (event) => this.typed(event), { signal });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.recoloured(), { signal });
  }

  private recoloured(): void {
    this.theme = themeOf(this.frame);
    this.groundDrawn = 0;
  }

  private point(event: MouseEvent): Point {
    const { left, top } = this.frame.getBoundingClientRect();
    return { x: event.clientX - left, y: event.clientY - top };
  }

  private pressed(canvas: HTMLCanvasElement, event: PointerEvent): void {
    canvas.setPointerCapture(event.pointerId);
    if (!this.pointers.size) this.wandered = 0;
    this.pointers.set(event.pointerId, this.point(event));
  }

  private moved(event: PointerEvent): void {
    const before = this.pointers.get(event.pointerId);
    const { camera } = this;
    if (!before || !camera) return;
    const point = this.point(event);
    this.pointers.set(event.pointerId, point);
    this.wandered += Math.hypot(point.x - before.x, point.y - before.y);
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
    if (!other) this.look(dragged(camera, point.x - before.x, point.y - before.y));
    else {
      const apart = (each: Point): number => Math.max(1, Math.hypot(each.x - other.x, each.y - other.y));
      this.zoom(apart(point) / apart(before), other);
    }
  }

  private released(event: PointerEvent): void {
    const alone = this.pointers.size === 1;
    this.pointers.delete(event.pointerId);
    if (event.type === "pointerup" && alone && this.wandered < CLICK_PIXELS) this.clicked(this.point(event));
  }

  private clicked(point: Point): void {
    const { camera } = this;
    if (!camera) return;
    const scene = this.scene(live.now());
    const { select } = this.properties();
    select(nearest(scene, toWorld(camera, this.size, point), REACH_PIXELS / camera.scale)?.name);
  }

  private rolled(event: WheelEvent): void {
    event.preventDefault();
    this.zoom(Math.exp(-event.deltaY / 500), this.point(event));
  }

  private typed(event: KeyboardEvent): void {
    const { camera } = this;
    const way = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (!camera || event.ctrlKey || event.metaKey || event.altKey) return;
    if (way) this.look(dragged(camera, KEY_PIXELS * (way[0] ?? 0), KEY_PIXELS * (way[1] ?? 0)));
    else if (event.key === "+" || event.key === "=") this.zoom(KEY_ZOOM);
    else if (event.key === "-") this.zoom(1 / KEY_ZOOM);
    else if (event.key === "0") this.fit();
    else return;
    event.preventDefault();
  }
}
