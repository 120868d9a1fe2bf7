/** Nodes that are several agents' (trial mode), in words. */
import type { Agent } from "../live/model";
import { count } from "../words";

const NAMED = 4;

/** "shares Node a with b, c (trial)"; empty where the Node is one agent's alone. */
export function sharedWords(node: Agent["nodes"][number]): string {
  const others = node.shared_with;
  if (!others.length) return "";
  const named = others.slice(0, NAMED).join(", ");
  const more = others.length > NAMED ? ` and ${others.length - NAMED} more` : "";
  return `shares Node ${node.name} with ${named}${more} (trial)`;
}

/** What several agents on one Node mean, for as long as there are any; empty where each has its own. */
export function trialWords(agents: Iterable<Agent>): string {
  const shared = new Set<string>();
  for (const agent of agents) for (const node of agent.nodes) if (node.shared_with.length) shared.add(node.name);
  if (!shared.size) return "";
  const nodes = `${count(shared.size, "Node is", "Nodes are")} several agents'`;
  return `Trial mode: ${nodes}, so no machine keeps them apart, and no figure compares machines.`;
}
