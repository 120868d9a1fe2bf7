import type { Agent, Pose, Rule, RuleEvent } from "../live/model";
import { boundsOf, type Bounds, type Point } from "./camera";
import { silentSince, type Tracks } from "./fleet";
import type { Place, Track } from "./tracks";

/** An agent as it is drawn. */
export interface Drawn {
  readonly name: string;
  readonly role: string;
  readonly place: Place;
  readonly track: Track;
  readonly silent: boolean;
  readonly inEvent: boolean;
  readonly found: boolean;
}

/** Everything on the map at one time. */
export interface Scene {
  readonly agents: readonly Drawn[];
  readonly byName: ReadonlyMap<string, Drawn>;
  readonly events: readonly RuleEvent[];
  readonly areas: readonly (readonly Point[])[];
  readonly selected: Drawn | undefined;
  /** Distances at which events of the selected agent begin and end. */
  readonly distances: readonly Distance[];
}

export interface Distance {
  readonly metres: number;
  readonly begins: boolean;
}

export interface SceneInput {
  readonly tracks: Tracks;
  readonly agents: ReadonlyMap<string, Agent>;
  readonly poses: ReadonlyMap<string, Pose>;
  readonly events: Iterable<RuleEvent>;
  readonly rules: Iterable<Rule>;
  /** Names that the search found; undefined when nothing is searched. */
  readonly found: ReadonlySet<string> | undefined;
  readonly selected: string | undefined;
  readonly behind: number;
}

/**
 * How far behind the process's clock agents are drawn, so that mostly two samples surround the moment: samples come twice
 * a second, and every 2 s to a page that has to ask for them.
 */
export const BEHIND_MS = { live: 700, polling: 2_700 };

/** The scene at a time of the process's clock. */
export function sceneAt(input: SceneInput, now: number): Scene {
  const events = [...input.events].filter((event) => event.ended_ms === null && event.began_ms !== null);
  const involved = new Set(events.flatMap((event) => event.agents));
  const agents: Drawn[] = [];
  for (const [name, track] of input.tracks) {
    const place = track.at(now - input.behind);
    if (!place) continue;
    const agent = input.agents.get(name);
    agents.push({
      name,
      role: agent?.role ?? "",
      place,
      track,
      silent: silentSince(agent, input.poses.get(name), now) !== undefined,
      inEvent: involved.has(name),
      found: input.found?.has(name) ?? true,
    });
  }
  const rules = [...input.rules];
  const byName = new Map(agents.map((agent) => [agent.name, agent]));
  const selected = input.selected === undefined ? undefined : byName.get(input.selected);
  return { agents, byName, events, areas: areasOf(rules), selected, distances: selected ? distancesOf(rules) : [] };
}

/** The outlines of rules' areas; holes are outlines, too. */
export function areasOf(rules: readonly Rule[]): Point[][] {
  return rules.flatMap((rule) =>
    rule.areas.flatMap((polygon) => polygon.map((ring) => ring.map(([x = 0, y = 0]) => ({ x, y })))),
  );
}

/** The distances of rules about nearness, each once. */
export function distancesOf(rules: readonly Rule[]): Distance[] {
  const begins = new Set(rules.flatMap((rule) => rule.start_distance_m ?? []));
  const ends = new Set(rules.flatMap((rule) => rule.stop_distance_m ?? []));
  return [
    ...[...begins].map((metres) => ({ metres, begins: true })),
    ...[...ends].filter((metres) => !begins.has(metres)).map((metres) => ({ metres, begins: false })),
  ];
}

/** The bounds of everything that has a place: agents that the search found, and areas. */
export function sceneBounds(scene: Scene): Bounds | undefined {
  const found = scene.agents.filter((agent) => agent.found).map((agent) => agent.place);
  return boundsOf([...found, ...scene.areas.flat()]);
}

/** The agent whose place is nearest to a point of the world, within so many metres. */
export function nearest(scene: Scene, point: Point, metres: number): Drawn | undefined {
  let best: Drawn | undefined;
  let least = metres ** 2;
  for (const agent of scene.agents) {
    const square = (agent.place.x - point.x) ** 2 + (agent.place.y - point.y) ** 2;
    if (square <= least) [best, least] = [agent, square];
  }
  return best;
}
