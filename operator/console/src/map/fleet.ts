import type { Live } from "../live/live";
import type { Agent, Pose } from "../live/model";
import { Track } from "./tracks";

export const SILENT_MS = 3_000;

export type Tracks = ReadonlyMap<string, Track>;

/** The tracks of all agents that were heard, kept up to date with the table. */
export function tracksOf(live: Live): Tracks {
  const tracks = new Map<string, Track>();
  let seen = -1;
  live.listen(() => {
    const changed = live.table.changed.get("poses") ?? 0;
    if (changed === seen) return;
    seen = changed;
    follow(tracks, live.table.maps.poses);
  });
  return tracks;
}

/** Take the newest poses into the tracks, and forget agents that have none any more. */
export function follow(tracks: Map<string, Track>, poses: ReadonlyMap<string, Pose>): void {
  for (const [name, pose] of poses) {
    let track = tracks.get(name);
    if (!track) tracks.set(name, (track = new Track()));
    track.add({ x: pose.x, y: pose.y, heading: pose.heading, time: pose.received_ms });
  }
  for (const name of tracks.keys()) if (!poses.has(name)) tracks.delete(name);
}

/**
 * Since when nothing came of an agent: its Node stopped to report, or no pose came for 3 s; undefined while it speaks.
 * An agent that sends no poses is judged by its Node alone.
 */
export function silentSince(agent: Agent | undefined, pose: Pose | undefined, now: number): number | undefined {
  const node = agent?.silent_since_ms ?? undefined;
  const said = pose && now - pose.received_ms > SILENT_MS ? pose.received_ms : undefined;
  return node === undefined || said === undefined ? (node ?? said) : Math.min(node, said);
}
