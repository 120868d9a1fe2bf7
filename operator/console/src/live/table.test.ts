import { describe, expect, it } from "vitest";
import { ProcessClock } from "./clock";
import type { Change, Items, Snapshot } from "./model";
import { Table } from "./table";

const pose = (x: number) => ({ x, y: 0, z: 0, heading: null, stamp_ms: 0, received_ms: 0 });
const poses = (items: Record<string, number>): Items => ({
  poses: Object.fromEntries(Object.entries(items).map(([key, x]) => [key, pose(x)])),
});

function snapshot(version: number, items: Items): Snapshot {
  return { id: `e.${version}`, version, epoch: "e", time_ms: 0, items, links: { forge: "http://f", argocd: "" } };
}

function change(version: number, set: Items, gone: Record<string, string[]> = {}): Change {
  return { id: `e.${version}`, version, time_ms: 0, set, gone };
}

const xs = (table: Table) => Object.fromEntries([...table.maps.poses].map(([key, item]) => [key, item.x]));

describe("the table", () => {
  it("is the snapshot with the changes after it", () => {
    const table = new Table();
    table.replace(snapshot(4, poses({ a: 1, b: 2 })));
    table.apply(change(5, poses({ b: 3, c: 4 }), { poses: ["a"] }));
    expect([xs(table), table.id, table.links.forge]).toEqual([{ b: 3, c: 4 }, "e.5", "http://f"]);
  });

  it("applies nothing twice", () => {
    const table = new Table();
    table.replace(snapshot(4, {}));
    expect(table.apply(change(5, poses({ a: 1 })))).toBe(true);
    expect(table.apply(change(5, poses({ a: 9 })))).toBe(false);
    expect(table.apply(change(4, {}, { poses: ["a"] }))).toBe(false);
    expect(xs(table)).toEqual({ a: 1 });
  });

  it("keeps what is gone and there again in one change", () => {
    const table = new Table();
    table.replace(snapshot(1, poses({ a: 1 })));
    table.apply(change(2, poses({ a: 2 }), { poses: ["a"] }));
    expect(xs(table)).toEqual({ a: 2 });
  });

  it("forgets everything at another snapshot, also of a process that counts from the beginning", () => {
    const table = new Table();
    table.replace(snapshot(40, poses({ a: 1 })));
    table.replace(snapshot(1, poses({ b: 1 })));
    expect([xs(table), table.apply(change(2, {}))]).toEqual([{ b: 1 }, true]);
  });

  it("says which kinds changed", () => {
    const table = new Table();
    table.replace(snapshot(1, {}));
    const before = new Map(table.changed);
    table.apply(change(2, poses({ a: 1 }), { tasks: ["gone"], plans: [] }));
    const kinds = [...table.changed].filter(([kind, times]) => times !== before.get(kind)).map(([kind]) => kind);
    expect(kinds.sort()).toEqual(["poses", "tasks"]);
  });
});

describe("the process's clock", () => {
  it("is that of the fastest message", () => {
    let own = 1000;
    const clock = new ProcessClock(() => own);
    expect(clock.now()).toBe(1000);
    clock.heard(5000);
    own += 500;
    clock.heard(5200); // 300 ms late
    expect(clock.now()).toBeGreaterThan(5490);
    own += 100;
    clock.heard(5650);
    expect(clock.now()).toBe(5650);
  });

  it("follows a clock that was set back", () => {
    const clock = new ProcessClock(() => 0);
    clock.heard(100_000);
    for (let index = 0; index < 1000; index += 1) clock.heard(0);
    expect(clock.now()).toBeLessThan(10);
  });
});
