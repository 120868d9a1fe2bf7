import type { Point } from "./camera";

/** A position at a time, in milliseconds of the process's clock; heading in radians, counter-clockwise from x. */
export interface Sample extends Point {
  readonly time: number;
  readonly heading: number | null;
}

/** Where an agent is drawn: its position and heading, and whether that lies before its last sample. */
export interface Place extends Point {
  readonly heading: number | null;
}

export const TRAIL_MS = 30_000;
const SAMPLES_MAX = 120;
export const GAP_MS = 5_000;
const TURN = 2 * Math.PI;

/**
 * The samples of one agent, oldest first, as far back as its trail. Places between two samples are interpolated; after
 * the last one the agent stays where it was heard last, since nobody knows better.
 */
export class Track {
  readonly samples: Sample[] = [];

  /** Add a sample; one that is not newer than the last is dropped: it was heard twice, or late. */
  add(sample: Sample): boolean {
    const last = this.samples.at(-1);
    if (last && sample.time <= last.time) return false;
    this.samples.push(sample);
    const oldest = sample.time - TRAIL_MS;
    const kept = this.samples.findIndex((each) => each.time >= oldest);
    const surplus = Math.max(kept, this.samples.length - SAMPLES_MAX);
    if (surplus > 0) this.samples.splice(0, surplus);
    return true;
  }

  /** The place at a time, undefined before anything was heard. */
  at(time: number): Place | undefined {
    const last = this.samples.at(-1);
    if (!last || time >= last.time) return last;
    for (let index = this.samples.length - 2; index >= 0; index -= 1) {
      const before = this.samples[index] as Sample;
      if (before.time <= time) return between(before, this.samples[index + 1] as Sample, time);
    }
    return this.samples[0];
  }
}

/** The place between two samples; across a gap of more than 5 s the earlier one holds, since the way is not known. */
export function between(before: Sample, after: Sample, time: number): Place {
  const span = after.time - before.time;
  if (span > GAP_MS) return before;
  const part = (time - before.time) / span;
  return {
    x: before.x + (after.x - before.x) * part,
    y: before.y + (after.y - before.y) * part,
    heading: turned(before.heading, after.heading, part),
  };
}

/** A heading between two, by the shorter way round. */
export function turned(from: number | null, to: number | null, part: number): number | null {
  if (from === null || to === null) return to ?? from;
  const difference = ((((to - from) % TURN) + TURN + Math.PI) % TURN) - Math.PI;
  return from + difference * part;
}
