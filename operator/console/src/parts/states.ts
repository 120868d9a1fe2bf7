/** What states mean: how they are coloured, and in words why something waits. */
import type { Certificate, Plan, Release, Task, Unchecked } from "../live/model";
import { clock, duration } from "../words";
import type { Tone } from "./parts";

export function releaseTone(release: Release): Tone {
  if (release.health === "Healthy") return release.sync === "Synced" ? "good" : "busy";
  return release.health === "Degraded" || release.health === "Missing" ? "bad" : "busy";
}

export type TaskGroup = "active" | "waiting" | "refused" | "withdrawn";

/** What became of a task: its applications run, it waits, it was refused, or it was taken back. */
export function taskGroup(task: Task): TaskGroup {
  if (task.withdrawn) return "withdrawn";
  const [accepted, ready] = ["Accepted", "Ready"].map((type) => task.conditions.find((each) => each.type === type));
  if (accepted?.status === "False") return "refused";
  return ready?.status === "True" ? "active" : "waiting";
}

export const TASK_TONES: Record<TaskGroup, Tone> = {
  active: "good",
  waiting: "busy",
  refused: "bad",
  withdrawn: "quiet",
};

/** Why a task is where it is: the words of the first condition that does not hold, of the last one when all do. */
export function taskWords(task: Task): string {
  const open = task.conditions.find((condition) => condition.status !== "True") ?? task.conditions.at(-1);
  return open?.message || open?.reason || "No manager has looked at it yet.";
}

export const PLAN_TONES: Record<Plan["state"], Tone> = {
  open: "busy",
  merged: "busy",
  observed: "good",
  refused: "bad",
};

export const PLAN_WORDS: Record<Plan["state"], string> = {
  open: "waits for the gate",
  merged: "merged, being deployed",
  observed: "deployed",
  refused: "refused",
};

/** What a plan does: "2 releases created, 1 removed". */
export function planWords(plan: Plan): string {
  const parts = (["created", "changed", "removed"] as const)
    .filter((word) => plan[word].length)
    .map(
      (word, index) => `${plan[word].length}${index ? "" : plan[word].length === 1 ? " release" : " releases"} ${word}`,
    );
  return parts.join(", ") || "no release touched";
}

/** What came of the gate's checks: "9 checks of the gate hold", "1 of 3 checks of the gate does not hold". */
export function checksWords({ checks }: NonNullable<Plan["decision"]>): string {
  const failed = checks.filter((each) => each.problems.length).length;
  const all = checks.length === 1 ? "1 check" : `${checks.length} checks`;
  if (!failed) return `${all} of the gate ${checks.length === 1 ? "holds" : "hold"}`;
  return `${failed} of ${all} of the gate ${failed === 1 ? "does" : "do"} not hold`;
}

/** The seconds from the demand to pods that run, undefined while it is under way. */
export function planSeconds(plan: Plan): number | undefined {
  const began = plan.demand_seen_ms ?? plan.started_ms;
  return began === null || plan.observed_ms === null ? undefined : (plan.observed_ms - began) / 1000;
}

const PAST_THE_GATE: Record<Unchecked["how"], string> = {
  "break-glass": "break-glass",
  "not-signed": "signatures do not hold",
  "no-record": "past the gate",
  records: "records are missing",
};

/** What a commit that the gate did not check is, and whether it was made good since. */
export function uncheckedState(commit: Unchecked): { tone: Tone; words: string } {
  const how = PAST_THE_GATE[commit.how];
  if (commit.made_good) return { tone: "quiet", words: `${how}, ${commit.made_good} since` };
  if (!commit.commit) return { tone: "bad", words: how };
  return { tone: commit.how === "break-glass" ? "warn" : "bad", words: `${how}, stands` };
}

/** Until when an account's certificate holds; a warning once a quarter of the time for its renewal has gone unused. */
export function certificateState(certificate: Certificate, now: number): { tone: Tone; words: string } {
  const { until_ms: until, renewal_ms: renewal } = certificate;
  if (until === null || renewal === null) return { tone: "bad", words: "has no certificate that holds" };
  if (now >= until) return { tone: "bad", words: `ended ${clock(until, now)}` };
  if (now < renewal + (until - renewal) / 4) return { tone: "good", words: `until ${clock(until, now)}` };
  return { tone: "warn", words: `ends in ${duration((until - now) / 1000)}` };
}

/** When it was made, and when it is to be made anew. */
export function renewalWords({ from_ms: from, renewal_ms: renewal }: Certificate, now: number): string {
  if (from === null || renewal === null) return "";
  const due = renewal > now ? "to be renewed" : "was to be renewed";
  return `made ${clock(from, now)}, ${due} ${clock(renewal, now)}`;
}
