import { describe, expect, it } from "vitest";
import type { Agent, Pose, Rule, RuleEvent } from "../live/model";
import { follow, silentSince } from "./fleet";
import { nearest, sceneAt, sceneBounds, type SceneInput } from "./scene";
import type { Track } from "./tracks";

const NOW = 1_000_000;
const pose = (x: number, received = NOW): Pose => ({
  x,
  y: 0,
  z: 0,
  heading: 0,
  stamp_ms: received,
  received_ms: received,
});
const agent = (name: string, more: Partial<Agent> = {}): Agent => ({
  ...{ name, namespace: name, role: "vehicle", records: false, capabilities: [], nodes: [], ready: true },
  ...{ silent_since_ms: null, hold: null },
  ...more,
});
const event = (id: string, agents: string[], ended: number | null = null): RuleEvent => ({
  ...{ id, rule: "near", agents, began_ms: NOW - 50, ended_ms: ended, stamp_ms: null, trace: "", distance_m: 40 },
  ...{ detail: {}, causes: [], task: "", detector: "", error: "" },
});
const rule = (name: string, start: number | null, stop: number | null, areas: number[][][][] = []): Rule => ({
  ...{ name, kind: "proximity", detector: "cloud-0/detector", text: "", areas },
  ...{ start_distance_m: start, stop_distance_m: stop },
});

function input(poses: Record<string, Pose>, more: Partial<SceneInput> = {}): SceneInput {
  const tracks = new Map<string, Track>();
  const map = new Map(Object.entries(poses));
  follow(tracks, map);
  const agents = new Map(Object.keys(poses).map((name) => [name, agent(name)]));
  return {
    tracks,
    agents,
    poses: map,
    events: [],
    rules: [],
    found: undefined,
    selected: undefined,
    behind: 0,
    ...more,
  };
}

describe("silence", () => {
  it("is said since the last pose, never as fine", () => {
    expect(silentSince(agent("a"), pose(0, NOW - 3000), NOW)).toBeUndefined();
    expect(silentSince(agent("a"), pose(0, NOW - 3001), NOW)).toBe(NOW - 3001);
  });
  it("is said since its Node stopped to report, whichever is longer ago", () => {
    expect(silentSince(agent("a", { silent_since_ms: 7 }), pose(0), NOW)).toBe(7);
    expect(silentSince(agent("a", { silent_since_ms: NOW }), pose(0, 5), NOW)).toBe(5);
    expect(silentSince(agent("a"), undefined, NOW)).toBeUndefined();
  });
});

describe("the scene", () => {
  it("has agents where they were heard, silent ones marked", () => {
    const scene = sceneAt(input({ a: pose(1), b: pose(2, NOW - 60_000) }), NOW);
    expect(scene.agents.map(({ name, silent }) => [name, silent])).toEqual([
      ["a", false],
      ["b", true],
    ]);
  });

  it("marks agents of events that last", () => {
    const events = [event("1", ["a"]), event("2", ["b"], NOW)];
    const scene = sceneAt(input({ a: pose(1), b: pose(2) }, { events }), NOW);
    expect(scene.agents.map((each) => each.inEvent)).toEqual([true, false]);
    expect(scene.events.map((each) => each.id)).toEqual(["1"]);
  });

  it("shows distances of rules around the selected agent, each once", () => {
    const rules = [rule("x", 400, 500), rule("y", 500, 600)];
    const scene = sceneAt(input({ a: pose(1) }, { rules, selected: "a" }), NOW);
    expect(scene.distances.map(({ metres, begins }) => [metres, begins])).toEqual([
      [400, true],
      [500, true],
      [600, false],
    ]);
    expect(sceneAt(input({ a: pose(1) }, { rules, selected: "gone" }), NOW).distances).toEqual([]);
  });

  it("is bounded by what was found, and by areas", () => {
    const found = sceneAt(input({ a: pose(1), b: pose(200) }, { found: new Set(["a"]) }), NOW);
    expect(sceneBounds(found)).toMatchObject({ left: 1, right: 1 });
    const outer = [
      [0, -5],
      [1, 9],
    ];
    const whole = sceneAt(input({ a: pose(1) }, { rules: [rule("z", null, null, [[outer]])] }), NOW);
    expect(sceneBounds(whole)).toEqual({ left: 0, right: 1, bottom: -5, top: 9 });
  });

  it("knows the nearest agent", () => {
    const scene = sceneAt(input({ a: pose(1), b: pose(20) }), NOW);
    expect(nearest(scene, { x: 17, y: 1 }, 5)?.name).toBe("b");
    expect(nearest(scene, { x: 10, y: 0 }, 5)).toBeUndefined();
  });
});
