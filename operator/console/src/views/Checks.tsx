import type { Plan } from "../live/model";
import { checksWords } from "../parts/states";

/** What the gate tried of a plan, each check with what it said. */
export function Checks({ plan }: { plan: Plan }) {
  if (!plan.decision) return null;
  return (
    <details class="changes">
      <summary>{checksWords(plan.decision)}</summary>
      <dl>
        {plan.decision.checks.map(({ check, problems, took_ms }) => (
          <div key={check}>
            <dt>{check}</dt>
            <dd>
              {problems.length ? <span class="bad">{problems.join("; ")}</span> : "holds"}
              {took_ms > 0 && <span class="quiet"> {took_ms} ms</span>}
            </dd>
          </div>
        ))}
      </dl>
    </details>
  );
}
