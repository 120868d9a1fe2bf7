import { describe, expect, it } from "vitest";
import { after, START, waited, type Connection, type Happening, type Next } from "./connection";

function run(happenings: Happening[], from: Connection = START): [Connection, Next] {
  let state = from;
  let next: Next = { kind: "nothing" };
  for (const happening of happenings) [state, next] = after(state, happening);
  return [state, next];
}

const SNAPSHOT: Happening = { kind: "snapshot" };
const EVENT: Happening = { kind: "event" };
const MUTE: Happening = { kind: "mute" };
const POLLED: Happening = { kind: "polled" };
const failed = (status: number): Happening => ({ kind: "failed", status, problem: "it said no" });

describe("the connection", () => {
  it("follows the stream after one snapshot", () => {
    expect(run([SNAPSHOT])[1]).toEqual({ kind: "stream", seconds: 0 });
    expect(run([SNAPSHOT, EVENT])[0].mode).toBe("live");
  });

  it("resumes a stream that broke, without another snapshot", () => {
    expect(run([SNAPSHOT, EVENT, { kind: "ended" }])[1]).toEqual({ kind: "stream", seconds: 0 });
  });

  it("reads a snapshot when the gap is too old, streaming or polling", () => {
    expect(run([SNAPSHOT, MUTE, MUTE, POLLED, failed(410)])[1]).toEqual({ kind: "snapshot", seconds: 0 });
    expect(run([SNAPSHOT, MUTE, MUTE, POLLED, failed(410), SNAPSHOT])[1].kind).toBe("changes");
    expect(run([SNAPSHOT, EVENT, { kind: "resync" }])[1]).toEqual({ kind: "snapshot", seconds: 0 });
  });

  it("resumes after the process was away, and reads a snapshot only when there is no table", () => {
    expect(run([failed(503)])[1]).toEqual({ kind: "snapshot", seconds: 1 });
    expect(run([SNAPSHOT, EVENT, failed(0)])[1]).toEqual({ kind: "stream", seconds: 1 });
    expect(run([SNAPSHOT, EVENT, { kind: "resync" }, failed(0)])[1]).toEqual({ kind: "snapshot", seconds: 1 });
  });

  it("polls when two streams stay mute, says why, and tries the stream again later", () => {
    const [buffered, next] = run([SNAPSHOT, MUTE, MUTE]);
    expect(next).toEqual({ kind: "changes", seconds: 0 });
    let [state, step] = after(buffered, POLLED);
    expect([state.mode, step]).toEqual(["polling", { kind: "changes", seconds: 2 }]);
    expect(state.problem).toContain("keeps answers back");
    for (let polls = 1; polls < 30; polls += 1) [state, step] = after(state, POLLED);
    expect(step.kind).toBe("stream");
    expect(after(state, MUTE)[1].kind).toBe("changes");
    expect(after(state, EVENT)[0]).toMatchObject({ mode: "live", problem: "", mute: 0 });
  });

  it("does not take a stream that was alive for one that is kept back", () => {
    const [state, next] = run([SNAPSHOT, EVENT, MUTE, EVENT, MUTE, EVENT, MUTE]);
    expect([state.mute, next.kind]).toEqual([0, "stream"]);
  });

  it("waits longer with each failure, and at most 15 s", () => {
    const seconds = [1, 2, 3, 4, 5, 6, 7].map((times) => {
      const [, next] = run(Array.from({ length: times }, () => failed(503)));
      return next.kind === "nothing" ? undefined : next.seconds;
    });
    expect(seconds).toEqual([1, 2, 4, 8, 15, 15, 15]);
    expect(run([failed(503), failed(503)])[0]).toMatchObject({ mode: "away", problem: "it said no" });
  });

  it("comes back at any time up to the pause, and asks for changes at their interval", () => {
    const half = ([state, next]: [Connection, Next]): number => waited(state, next, () => 0.5);
    expect(half(run([failed(503), failed(503), failed(503)]))).toBe(2);
    expect(half(run([SNAPSHOT, { kind: "ended" }]))).toBe(0.5);
    expect(half(run([SNAPSHOT, MUTE, MUTE, POLLED]))).toBe(2);
    expect(half(run([SNAPSHOT, MUTE, MUTE, POLLED, failed(503)]))).toBe(0.5);
    expect(half(run([failed(401)]))).toBe(0);
  });

  it("asks no more when it may not read", () => {
    expect(run([failed(401)])).toMatchObject([{ mode: "signed-out" }, { kind: "nothing" }]);
    expect(run([failed(403)])).toMatchObject([{ mode: "forbidden" }, { kind: "nothing" }]);
  });
});
