/**
 * The connection to the process as values: what happened leads to a state and to what is done next. The rules:
 *
 * - one snapshot first, then changes after its version; a stream that breaks is resumed after the last version heard;
 * - a stream on which nothing comes in time, not even a heartbeat, is cut and opened again; when that happens twice in a
 *   row without a single event, something on the way keeps answers back, and the page asks for changes instead;
 * - from polling the stream is tried again from time to time;
 * - who may not read is told so, and asked for no more.
 */
export type Mode = "starting" | "live" | "polling" | "away" | "signed-out" | "forbidden";

export interface Connection {
  readonly mode: Mode;
  /** Whether there is a table that changes can be applied to. */
  readonly whole: boolean;
  /** Attempts in a row that failed. */
  readonly failures: number;
  /** Streams in a row on which nothing came. */
  readonly mute: number;
  /** Whether anything came on the present stream. */
  readonly heard: boolean;
  /** Changes asked for since the stream was given up. */
  readonly polls: number;
  /** What went wrong last, in words; empty when all is well. */
  readonly problem: string;
}

export type Happening =
  | { readonly kind: "snapshot" | "polled" }
  | { readonly kind: "event" }
  | { readonly kind: "mute" }
  | { readonly kind: "ended" }
  | { readonly kind: "resync" }
  | { readonly kind: "failed"; readonly status: number; readonly problem: string };

/** What is done next, after so many seconds: read the snapshot, open the stream, ask for changes; or nothing. */
export type Next =
  { readonly kind: "snapshot" | "stream" | "changes"; readonly seconds: number } | { readonly kind: "nothing" };

export const START: Connection = {
  mode: "starting",
  whole: false,
  failures: 0,
  mute: 0,
  heard: false,
  polls: 0,
  problem: "",
};
export const MUTE_SECONDS_MAX = 12;
const MUTE_STREAMS_MAX = 2;
const POLL_SECONDS = 2;
const POLLS_BEFORE_STREAM = 30;
const PAUSE_SECONDS_MAX = 15;
const STAY: Next = { kind: "nothing" };

/** The state after something happened, and what is done next. */
export function after(state: Connection, happening: Happening): [Connection, Next] {
  switch (happening.kind) {
    case "snapshot":
      return [
        { ...state, ...WELL, whole: true },
        { kind: onward(state), seconds: 0 },
      ];
    case "polled":
      return polled(state);
    case "event":
      return [{ ...state, ...WELL, mode: "live", heard: true, mute: 0, polls: 0 }, STAY];
    case "mute":
      return muted(state);
    case "ended":
      return [
        { ...state, heard: false },
        { kind: "stream", seconds: pause(state.heard ? 0 : 1) },
      ];
    case "resync":
      return [
        { ...state, whole: false, heard: false },
        { kind: "snapshot", seconds: 0 },
      ];
    case "failed":
      return failed(state, happening.status, happening.problem);
  }
}

const WELL = { failures: 0, problem: "" };

/** Nothing came for too long: a stream that was alive is opened again; one that never was counts as kept back. */
function muted(state: Connection): [Connection, Next] {
  const mute = state.heard ? 0 : state.mute + 1;
  const muter = { ...state, mute, heard: false };
  return [muter, { kind: onward(muter), seconds: 0 }];
}

function polled(state: Connection): [Connection, Next] {
  const polls = state.polls + 1;
  const again = polls % POLLS_BEFORE_STREAM === 0;
  const problem = "Something between here and the platform keeps answers back, so the page asks every 2 s.";
  return [
    { ...state, mode: "polling", failures: 0, polls, problem, mute: again ? MUTE_STREAMS_MAX - 1 : state.mute },
    again ? { kind: "stream", seconds: 0 } : { kind: "changes", seconds: POLL_SECONDS },
  ];
}

function failed(state: Connection, status: number, problem: string): [Connection, Next] {
  if (status === 401) return [{ ...state, mode: "signed-out", problem }, STAY];
  if (status === 403) return [{ ...state, mode: "forbidden", problem }, STAY];
  if (status === 410) return after(state, { kind: "resync" });
  const failures = state.failures + 1;
  const mode = state.mode === "starting" && failures < 2 ? "starting" : "away";
  const kind = state.whole ? onward(state) : "snapshot";
  return [
    { ...state, mode, failures, heard: false, problem },
    { kind, seconds: pause(failures) },
  ];
}

/** How the table is followed: by the stream, by asking where streams are kept back. */
function onward(state: Connection): "stream" | "changes" {
  return state.mute >= MUTE_STREAMS_MAX ? "changes" : "stream";
}

/**
 * Seconds that are waited before what is done next. Changes are asked for at their interval; an attempt after a failure or
 * a stream that ended comes at any time up to its pause, so that the pages of many people do not all come back at once.
 * `random`: numbers from 0 up to 1.
 */
export function waited(state: Connection, next: Next, random: () => number): number {
  if (next.kind === "nothing") return 0;
  return next.kind === "changes" && !state.failures ? next.seconds : next.seconds * random();
}

/** The longest pause in seconds before the next attempt: none at first, then 1, 2, 4, ..., at most 15. */
export function pause(failures: number): number {
  return failures === 0 ? 0 : Math.min(PAUSE_SECONDS_MAX, 2 ** (failures - 1));
}
