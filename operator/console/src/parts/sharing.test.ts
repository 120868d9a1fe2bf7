import { describe, expect, it } from "vitest";
import type { Agent } from "../live/model";
import { sharedWords, trialWords } from "./sharing";

const node = (name: string, ...others: string[]): Agent["nodes"][number] => ({
  ...{ name, ready: true, cordoned: false, since_ms: null, shared_with: others },
});
const agent = (...nodes: Agent["nodes"]): Agent => ({ nodes }) as unknown as Agent;

describe("a Node", () => {
  it("of one agent says nothing of sharing", () => expect(sharedWords(node("worker-1"))).toBe(""));
  it("of several names the others", () =>
    expect(sharedWords(node("worker-1", "cloud-0", "vehicle-01"))).toBe(
      "shares Node worker-1 with cloud-0, vehicle-01 (trial)",
    ));
  it("of many names the first of them", () =>
    expect(sharedWords(node("worker-1", "a", "b", "c", "d", "e", "f"))).toBe(
      "shares Node worker-1 with a, b, c, d and 2 more (trial)",
    ));
});

describe("a trial", () => {
  it("is none while every agent has a Node of its own, or none", () =>
    expect(trialWords([agent(node("worker-1")), agent()])).toBe(""));
  it("counts each shared Node once, and says what that means", () => {
    const [one, two] = [node("worker-1", "b"), node("worker-1", "a")];
    const means = "so no machine keeps them apart, and no figure compares machines.";
    expect(trialWords([agent(one), agent(two)])).toBe(`Trial mode: 1 Node is several agents', ${means}`);
    expect(trialWords([agent(one), agent(two), agent(node("worker-2", "c"))])).toBe(
      `Trial mode: 2 Nodes are several agents', ${means}`,
    );
  });
});
