import { describe, expect, it } from "vitest";
import type { Certificate, Plan, Task, Unchecked } from "../live/model";
import {
  certificateState,
  renewalWords,
  checksWords,
  planSeconds,
  planWords,
  taskGroup,
  taskWords,
  uncheckedState,
} from "./states";

type Condition = Task["conditions"][number];
const condition = (type: Condition["type"], status: Condition["status"], message = ""): Condition => ({
  ...{ type, status, reason: "Why", message, time_ms: null },
});
const task = (conditions: Condition[], withdrawn = false): Task => ({ conditions, withdrawn }) as unknown as Task;
const plan = (more: Partial<Plan>): Plan =>
  ({
    created: [],
    changed: [],
    removed: [],
    demand_seen_ms: null,
    started_ms: null,
    observed_ms: null,
    ...more,
  }) as Plan;

describe("a task", () => {
  it.each([
    ["waiting", task([])],
    ["waiting", task([condition("Accepted", "True"), condition("Ready", "Unknown")])],
    ["refused", task([condition("Accepted", "False")])],
    ["active", task([condition("Accepted", "True"), condition("Ready", "True")])],
    ["withdrawn", task([condition("Ready", "True")], true)],
  ])("is %s", (group, each) => expect(taskGroup(each)).toBe(group));

  it("says why it waits in the words of what does not hold", () => {
    expect(
      taskWords(task([condition("Accepted", "True", "yes"), condition("Synced", "Unknown", "Argo CD is away")])),
    ).toBe("Argo CD is away");
    expect(taskWords(task([condition("Accepted", "False")]))).toBe("Why");
    expect(taskWords(task([condition("Accepted", "True", "a"), condition("Ready", "True", "all run")]))).toBe(
      "all run",
    );
    expect(taskWords(task([]))).toContain("No manager");
  });
});

describe("a plan", () => {
  it("says what it does", () => {
    expect(planWords(plan({ created: ["a", "b"], removed: ["c"] }))).toBe("2 releases created, 1 removed");
    expect(planWords(plan({ changed: ["a"] }))).toBe("1 release changed");
    expect(planWords(plan({}))).toBe("no release touched");
  });
  it("says whether the gate's checks hold", () => {
    const decision = (...problems: string[][]) => {
      const checks = problems.map((each, number) => ({ check: String(number), problems: each, took_ms: 1 }));
      return { checks } as NonNullable<Plan["decision"]>;
    };
    expect(checksWords(decision([], []))).toBe("2 checks of the gate hold");
    expect(checksWords(decision([]))).toBe("1 check of the gate holds");
    expect(checksWords(decision([], ["a"], []))).toBe("1 of 3 checks of the gate does not hold");
    expect(checksWords(decision(["a"], ["b"]))).toBe("2 of 2 checks of the gate do not hold");
  });
  it("takes from the demand to what runs", () => {
    expect(planSeconds(plan({ demand_seen_ms: 1000, observed_ms: 3500 }))).toBe(2.5);
    expect(planSeconds(plan({ started_ms: 1000 }))).toBeUndefined();
  });
});

describe("a commit that the gate did not check", () => {
  const state = (how: Unchecked["how"], made_good: Unchecked["made_good"], commit = "1") =>
    uncheckedState({ how, made_good, commit } as Unchecked);

  it.each([
    ["warn", "break-glass, stands", state("break-glass", "")],
    ["quiet", "break-glass, accepted since", state("break-glass", "accepted")],
    ["bad", "past the gate, stands", state("no-record", "")],
    ["quiet", "signatures do not hold, replaced since", state("not-signed", "replaced")],
    ["bad", "records are missing", state("records", "", "")],
  ])("is %s: %s", (tone, words, said) => expect(said).toEqual({ tone, words }));
});

describe("a certificate of 90 days", () => {
  const DAY = 86_400_000;
  const from = Date.UTC(2026, 0, 1);
  const certificate = { from_ms: from, renewal_ms: from + 60 * DAY, until_ms: from + 90 * DAY } as Certificate;
  const none = { from_ms: null, renewal_ms: null, until_ms: null } as Certificate;

  it.each([
    ["good", "until 1 Apr", 1],
    ["good", "until 1 Apr", 67],
    ["warn", "ends in 22 d", 68],
    ["bad", "ended", 90],
  ])("is %s: %s, after %i days", (tone, words, days) => {
    const said = certificateState(certificate, from + days * DAY);
    expect(said.tone).toBe(tone);
    expect(said.words).toContain(words);
  });
  it("is bad where there is none", () => {
    expect(certificateState(none, from)).toEqual({ tone: "bad", words: "has no certificate that holds" });
    expect(renewalWords(none, from)).toBe("");
  });
  it("says when it was made and is made anew", () => {
    expect(renewalWords(certificate, from + DAY)).toMatch(/^made 1 Jan .*, to be renewed 2 Mar /);
    expect(renewalWords(certificate, from + 68 * DAY)).toMatch(/, was to be renewed 2 Mar /);
  });
});
