import { openStream, readChange, readSnapshot, Refused } from "./api";
import { ProcessClock } from "./clock";
import { after, MUTE_SECONDS_MAX, START, waited, type Connection, type Happening, type Next } from "./connection";
import { FrameReader, type Frame } from "./frames";
import type { Change } from "./model";
import { Table } from "./table";

type Listener = () => void;

/**
 * Keeps the table as the process has it, and tells who listens. One step at a time: what a step led to goes into
 * `after`, which says what the next one is.
 */
export class Live {
  readonly table = new Table();
  private readonly clock = new ProcessClock(() => Date.now());
  connection: Connection = START;
  /** Where to sign in, as the process said when it refused. */
  signIn: string | undefined;
  /** When something came of the process last, by its clock; 0 before anything did. */
  heardAt = 0;
  private readonly listeners = new Set<Listener>();
  private readonly ended = new AbortController();

  /** Call `listener` after each change of table or connection; returns what ends that. */
  listen(listener: Listener): () => void {
    this.listeners.add(listener);
    return () => this.listeners.delete(listener);
  }

  /** Follow the process until `end`, or until it says that it will not be read. */
  async run(): Promise<void> {
    let next: Next = { kind: "snapshot", seconds: 0 };
    while (next.kind !== "nothing" && !this.ended.signal.aborted) {
      await pause(waited(this.connection, next, Math.random));
      next = await this.step(next.kind);
    }
  }

  /** The process's time of what is shown: while nothing comes of it, that of the last message. */
  now(): number {
    return this.connection.mode === "away" ? this.heardAt : this.clock.now();
  }

  end(): void {
    this.ended.abort();
  }

  private async step(kind: "snapshot" | "stream" | "changes"): Promise<Next> {
    try {
      if (kind === "snapshot") return await this.snapshot();
      if (kind === "changes") return await this.changes();
      return this.happened(await this.stream());
    } catch (error) {
      const refused = error instanceof Refused ? error : new Refused(0, "Not readable", unreadable(error), undefined);
      this.signIn = refused.signIn;
      return this.happened({ kind: "failed", status: refused.status, problem: refused.message });
    }
  }

  private async snapshot(): Promise<Next> {
    const snapshot = await readSnapshot(this.ended.signal);
    this.table.replace(snapshot);
    this.heard(snapshot.time_ms);
    return this.happened({ kind: "snapshot" });
  }

  private async changes(): Promise<Next> {
    this.apply(await readChange(this.table.id, this.ended.signal));
    return this.happened({ kind: "polled" });
  }

  /** Read the stream until it ends, stays mute or says `resync`. */
  private async stream(): Promise<Happening> {
    const cut = new AbortController();
    const signal = AbortSignal.any([cut.signal, this.ended.signal]);
    let patience = setTimeout(() => cut.abort(), MUTE_SECONDS_MAX * 1000);
    const reading = new FrameReader();
    try {
      const reader = await openStream(this.table.id, signal);
      for (;;) {
        const { done, value } = await reader.read();
        if (done) return { kind: "ended" };
        const frames = reading.read(value).filter((frame) => frame.kind === "event");
        if (!frames.length) continue;
        clearTimeout(patience);
        patience = setTimeout(() => cut.abort(), MUTE_SECONDS_MAX * 1000);
        if (!frames.every((frame) => this.taken(frame))) return { kind: "resync" };
        this.happened({ kind: "event" });
      }
    } catch (error) {
      if (cut.signal.aborted) return { kind: "mute" };
      if (error instanceof Refused) throw error;
      return { kind: "ended" };
    } finally {
      clearTimeout(patience);
      cut.abort();
    }
  }

  /** As `frame`; what cannot be taken is no stream that ended, which would be opened again at once. */
  private taken(frame: Frame): boolean {
    try {
      return this.frame(frame);
    } catch (error) {
      throw new Refused(0, "Not readable", unreadable(error), undefined);
    }
  }

  /** Take what the stream says; false when it says that the table has to be read anew. */
  private frame(frame: Frame): boolean {
    if (frame.kind !== "event") return true;
    if (frame.event === "resync") return false;
    const said = JSON.parse(frame.data) as Change;
    if (frame.event === "change") this.apply(said);
    else if (frame.event === "heartbeat") this.heard(said.time_ms);
    return true;
  }

  private apply(change: Change): void {
    this.heard(change.time_ms);
    this.table.apply(change);
  }

  private heard(time: number): void {
    this.heardAt = time;
    this.clock.heard(time);
  }

  private happened(happening: Happening): Next {
    const [connection, next] = after(this.connection, happening);
    this.connection = connection;
    for (const listener of this.listeners) listener();
    return next;
  }
}

/** The page is never shown as live when what it was told is of no use to it. */
const unreadable = (error: unknown): string =>
  `The page cannot read what the console says (${error instanceof Error ? error.message : String(error)}). ` +
  "Load the page anew: it may be of another version.";

function pause(seconds: number): Promise<void> {
  return seconds ? new Promise((resolve) => setTimeout(resolve, seconds * 1000)) : Promise.resolve();
}
