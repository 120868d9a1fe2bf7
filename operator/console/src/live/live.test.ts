import { afterEach, describe, expect, it, vi } from "vitest";
import { Live } from "./live";
import type { Change } from "./model";

const pose = (x: number) => ({ x, y: 0, z: 0, heading: null, stamp_ms: 0, received_ms: 0 });
const change = (version: number, x: number): Change => ({
  ...{ id: `e.${version}`, version, time_ms: 1000 + version, gone: {} },
  set: { poses: { a: pose(x) } },
});
const frame = (event: string, data: object): string => `event: ${event}\ndata: ${JSON.stringify(data)}\n\n`;
const json = (document: object, status = 200): Response => new Response(JSON.stringify(document), { status });
const snapshot = (version: number): Response =>
  json({ id: `e.${version}`, version, time_ms: 1000, items: {}, links: { forge: "", argocd: "" } });
const signIn = (): Response =>
  json({ status: 401, title: "Not signed in", detail: "Sign in.", sign_in: "/auth/login" }, 401);

/** A stream that comes in these pieces, one after the other. */
const pieces = (...texts: string[]): Response => {
  const bytes = new ReadableStream<Uint8Array>({
    pull: (controller) => {
      const text = texts.shift();
      if (text === undefined) controller.close();
      else controller.enqueue(new TextEncoder().encode(text));
    },
  });
  return new Response(bytes);
};

/** Follows a process that gives these answers, one after the other, and says what it was asked for. */
async function followed(...answers: Response[]): Promise<[Live, string[]]> {
  const asked: string[] = [];
  const fetch = vi.fn((path: string) => {
    asked.push(path);
    return Promise.resolve(answers.shift() as Response);
  });
  vi.stubGlobal("fetch", fetch);
  const live = new Live();
  await live.run();
  return [live, asked];
}

afterEach(() => vi.unstubAllGlobals());

describe("following the process", () => {
  it("resumes a stream after the last change that it heard, and applies nothing twice", async () => {
    const first = new Response(frame("heartbeat", { version: 4, time_ms: 1 }) + frame("change", change(5, 1)));
    const second = new Response(frame("change", change(5, 99)) + frame("change", change(6, 2)));
    const [live, asked] = await followed(snapshot(4), first, second, signIn());
    expect(asked).toEqual(["api/snapshot", "api/events?after=e.4", "api/events?after=e.5", "api/events?after=e.6"]);
    expect([live.table.version, live.table.maps.poses.get("a")?.x]).toEqual([6, 2]);
    expect([live.connection.mode, live.signIn]).toEqual(["signed-out", "/auth/login"]);
  });

  it("reads a snapshot when the stream says that it cannot go on", async () => {
    const stream = new Response(frame("change", change(5, 1)) + frame("resync", { reason: "another start" }));
    const [live, asked] = await followed(snapshot(4), stream, snapshot(1), signIn());
    expect(asked.slice(1)).toEqual(["api/events?after=e.4", "api/snapshot", "api/events?after=e.1"]);
    expect(live.table.maps.poses.size).toBe(0);
  });

  it("says so when it cannot read a snapshot, and asks again", async () => {
    vi.useFakeTimers();
    const broken = json({ id: "e.4", version: 4, time_ms: 1000, items: { poses: null, tasks: 5 }, links: null });
    const following = followed(json(null as unknown as object), broken, signIn());
    await vi.advanceTimersByTimeAsync(10_000);
    const [live, asked] = await following;
    vi.useRealTimers();
    expect(asked.slice(0, 2)).toEqual(["api/snapshot", "api/snapshot"]);
    expect(live.connection.mode).toBe("signed-out");
  });

  it("does not open a stream again at once whose change it cannot read", async () => {
    vi.useFakeTimers();
    vi.spyOn(Math, "random").mockReturnValue(0.95);
    const beat = frame("heartbeat", { version: 4, time_ms: 1 });
    const broken = pieces(beat, frame("change", { id: "e.5" }));
    const following = followed(snapshot(4), broken, signIn());
    await vi.advanceTimersByTimeAsync(900);
    const asked = vi.mocked(fetch).mock.calls.length;
    await vi.advanceTimersByTimeAsync(1000);
    await following;
    vi.useRealTimers();
    vi.restoreAllMocks();
    expect(asked).toBe(2);
  });

  it("tells who listens, and says of when it is", async () => {
    const [live] = await followed(snapshot(4), new Response(frame("change", change(7, 1))), signIn());
    expect(live.heardAt).toBe(1007);
    const told = vi.fn();
    live.listen(told)();
    expect(told).not.toHaveBeenCalled();
  });
});
