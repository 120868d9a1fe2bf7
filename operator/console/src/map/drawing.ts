import { lengthInWords, roundLength, toScreen, type Camera, type Point, type Size } from "./camera";
import type { Drawn, Scene } from "./scene";
import { GAP_MS } from "./tracks";

/** Colours of the page, as the style sheet says them for light and dark. */
export interface Theme {
  readonly paper: string;
  readonly grid: string;
  readonly ink: string;
  readonly quiet: string;
  readonly agent: string;
  readonly event: string;
  readonly silent: string;
  readonly accent: string;
  readonly font: string;
}

const TAU = 2 * Math.PI;
const LABELS_MAX = 60;
const ROLES_MAX = 20;
const NAMED_EVENTS_MAX = 15;
export const TRAILS_EACH_FRAME_MAX = 100;
const FAINT = 0.25;
const RING_PIXELS = 16;
export const MANY = 300;
const SAMPLES_PASSED_OVER = 4;

/** The theme of an element, from the style sheet's custom properties. */
export function themeOf(element: Element): Theme {
  const style = getComputedStyle(element);
  const colour = (name: string): string => style.getPropertyValue(`--${name}`).trim();
  return {
    paper: colour("map"),
    grid: colour("grid"),
    ink: colour("ink"),
    quiet: colour("quiet"),
    agent: colour("agent"),
    event: colour("event"),
    silent: colour("silent"),
    accent: colour("accent"),
    font: style.fontFamily,
  };
}

/** One drawing: a context whose unit is a CSS pixel, where the map looks, and its colours. */
export class Drawing {
  constructor(
    private readonly context: CanvasRenderingContext2D,
    private readonly size: Size,
    private readonly camera: Camera,
    private readonly theme: Theme,
    /** The moment that is drawn. */
    private readonly until: number,
  ) {}

  /** What changes seldom: grid, areas, trails. */
  ground(scene: Scene): void {
    const { context, size, theme } = this;
    context.globalAlpha = 1;
    context.fillStyle = theme.paper;
    context.fillRect(0, 0, size.width, size.height);
    this.grid();
    for (const area of scene.areas) this.area(area);
    this.trails(scene.agents);
  }

  /** What moves: distances, events, agents and their names. */
  moving(scene: Scene): void {
    const { context, size } = this;
    context.clearRect(0, 0, size.width, size.height);
    for (const distance of scene.distances) if (scene.selected) this.distance(scene.selected, distance);
    this.events(scene);
    this.agents(scene.agents);
    if (scene.selected) this.selection(scene.selected);
    this.labels(scene);
  }

  private at(point: Point): Point {
    return toScreen(this.camera, this.size, point);
  }

  private visible({ x, y }: Point, margin: number): boolean {
    return x > -margin && y > -margin && x < this.size.width + margin && y < this.size.height + margin;
  }

  private grid(): void {
    const { context, camera, size, theme } = this;
    const step = roundLength(camera, 120);
    const left = camera.x - size.width / 2 / camera.scale;
    const bottom = camera.y - size.height / 2 / camera.scale;
    context.strokeStyle = theme.grid;
    context.lineWidth = 1;
    context.beginPath();
    for (let x = Math.ceil(left / step) * step; x < left + size.width / camera.scale; x += step) {
      const column = Math.round(this.at({ x, y: 0 }).x) + 0.5;
      context.moveTo(column, 0);
      context.lineTo(column, size.height);
    }
    for (let y = Math.ceil(bottom / step) * step; y < bottom + size.height / camera.scale; y += step) {
      const row = Math.round(this.at({ x: 0, y }).y) + 0.5;
      context.moveTo(0, row);
      context.lineTo(size.width, row);
    }
    context.stroke();
    this.bar(step);
  }

  private bar(metres: number): void {
    const { context, camera, size, theme } = this;
    const [right, y] = [size.width - 14, size.height - 14];
    context.strokeStyle = context.fillStyle = theme.quiet;
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(right - metres * camera.scale, y);
    context.lineTo(right, y);
    context.stroke();
    context.font = `12px ${theme.font}`;
    context.textAlign = "right";
    context.fillText(lengthInWords(metres), right, y - 6);
  }

  private area(points: readonly Point[]): void {
    const { context, theme } = this;
    context.beginPath();
    for (const point of points) {
      const { x, y } = this.at(point);
      context.lineTo(x, y);
    }
    context.closePath();
    context.fillStyle = context.strokeStyle = theme.accent;
    context.globalAlpha = 0.1;
    context.fill();
    context.globalAlpha = 0.8;
    context.lineWidth = 1.5;
    context.stroke();
    context.globalAlpha = 1;
  }

  private trails(agents: readonly Drawn[]): void {
    const { context, theme } = this;
    context.strokeStyle = theme.agent;
    context.globalAlpha = 0.35;
    context.lineWidth = 2;
    context.lineJoin = "round";
    context.beginPath();
    const step = agents.length > MANY ? SAMPLES_PASSED_OVER : 1;
    for (const agent of agents) {
      if (agent.found && this.visible(this.at(agent.place), 200)) this.trail(agent, step);
    }
    context.stroke();
    context.globalAlpha = 1;
  }

  /** From the oldest sample to where the agent is drawn: samples after that are its way to come. */
  private trail({ track, place }: Drawn, step: number): void {
    const { context } = this;
    let last = -Infinity;
    for (let index = 0; index < track.samples.length; index += step) {
      const sample = track.samples[index];
      if (!sample || sample.time > this.until) break;
      const { x, y } = this.at(sample);
      if (sample.time - last > GAP_MS) context.moveTo(x, y);
      else context.lineTo(x, y);
      last = sample.time;
    }
    const { x, y } = this.at(place);
    if (last > -Infinity) context.lineTo(x, y);
  }

  private distance(selected: Drawn, { metres, begins }: Scene["distances"][number]): void {
    const { context, camera, theme } = this;
    const { x, y } = this.at(selected.place);
    const radius = metres * camera.scale;
    context.strokeStyle = context.fillStyle = theme.accent;
    context.lineWidth = 1.5;
    context.setLineDash(begins ? [] : [6, 6]);
    context.beginPath();
    context.arc(x, y, radius, 0, TAU);
    context.stroke();
    context.setLineDash([]);
    context.font = `12px ${theme.font}`;
    context.textAlign = "center";
    context.fillText(`${begins ? "begins" : "ends"} at ${lengthInWords(metres)}`, x, y - radius - 5);
  }

  /** A line between the agents of each event and a ring around them; the distance where there are few events. */
  private events(scene: Scene): void {
    const { context, theme } = this;
    const named = scene.events.length <= NAMED_EVENTS_MAX;
    context.strokeStyle = theme.event;
    context.lineWidth = 2;
    context.beginPath();
    for (const event of scene.events) {
      const points = event.agents.flatMap((name) => scene.byName.get(name)?.place ?? []).map((place) => this.at(place));
      points.forEach(({ x, y }, index) => (index ? context.lineTo(x, y) : context.moveTo(x, y)));
      for (const { x, y } of points) {
        context.moveTo(x + RING_PIXELS, y);
        context.arc(x, y, RING_PIXELS, 0, TAU);
      }
    }
    context.stroke();
    for (const event of named ? scene.events : []) this.distanceOf(event, scene);
  }

  private distanceOf({ agents, distance_m: metres }: Scene["events"][number], scene: Scene): void {
    const [first, second] = agents
      .flatMap((name) => scene.byName.get(name)?.place ?? [])
      .map((place) => this.at(place));
    if (metres === null || !first || !second || Math.hypot(first.x - second.x, first.y - second.y) < 70) return;
    this.text(`${Math.round(metres)} m`, (first.x + second.x) / 2, (first.y + second.y) / 2 - 8, this.theme.event);
  }

  /** Agents of one colour are one path: a thousand of them are drawn in a few milliseconds. */
  private agents(agents: readonly Drawn[]): void {
    const { context, theme } = this;
    const colours: [string, (agent: Drawn) => boolean][] = [
      [theme.silent, (agent) => agent.silent],
      [theme.agent, (agent) => !agent.silent && !agent.inEvent],
      [theme.event, (agent) => !agent.silent && agent.inEvent],
    ];
    for (const found of [false, true]) {
      context.globalAlpha = found ? 1 : FAINT;
      for (const [colour, chosen] of colours) {
        context.fillStyle = colour;
        context.strokeStyle = theme.paper;
        context.lineWidth = 1;
        context.beginPath();
        for (const agent of agents) if (agent.found === found && chosen(agent)) this.marker(agent);
        context.fill();
        if (agents.length <= MANY) context.stroke();
      }
    }
    context.globalAlpha = 1;
  }

  /** An arrowhead along the heading; a square for those that have none; a silent agent is hollow. */
  private marker({ place, silent }: Drawn): void {
    const { context } = this;
    const { x, y } = this.at(place);
    if (!this.visible({ x, y }, 20)) return;
    if (place.heading === null) context.rect(x - 6, y - 6, 12, 12);
    else {
      const [cosine, sine] = [Math.cos(place.heading), -Math.sin(place.heading)];
      const corner = (along: number, across: number, begin = false): void => {
        const [cx, cy] = [x + along * cosine - across * sine, y + along * sine + across * cosine];
        if (begin) context.moveTo(cx, cy);
        else context.lineTo(cx, cy);
      };
      corner(11, 0, true);
      corner(-7, 7);
      corner(-3, 0);
      corner(-7, -7);
      context.closePath();
    }
    if (silent) {
      context.moveTo(x + 14, y);
      context.arc(x, y, 14, 0, TAU);
      context.arc(x, y, 12, TAU, 0, true);
    }
  }

  private selection(selected: Drawn): void {
    const { context, theme } = this;
    const { x, y } = this.at(selected.place);
    context.strokeStyle = theme.accent;
    context.lineWidth = 3;
    context.beginPath();
    context.arc(x, y, 20, 0, TAU);
    context.stroke();
  }

  private labels(scene: Scene): void {
    const shown = scene.agents.filter((agent) => agent.found && this.visible(this.at(agent.place), 0));
    const crowded = shown.length > LABELS_MAX;
    const few = scene.events.length <= NAMED_EVENTS_MAX;
    const named = crowded ? shown.filter((agent) => agent.inEvent && few) : shown;
    const { selected } = scene;
    const all = selected && !named.includes(selected) ? [...named, selected] : named;
    for (const agent of all) {
      const { x, y } = this.at(agent.place);
      this.text(agent.name, x, y + 28, this.theme.ink);
      if (all.length <= ROLES_MAX && agent.role) this.text(agent.role, x, y + 42, this.theme.quiet);
    }
  }

  private text(text: string, x: number, y: number, colour: string): void {
    const { context, theme } = this;
    context.font = `12px ${theme.font}`;
    context.textAlign = "center";
    context.lineWidth = 3;
    context.lineJoin = "round";
    context.strokeStyle = theme.paper;
    context.strokeText(text, x, y);
    context.fillStyle = colour;
    context.fillText(text, x, y);
  }
}
