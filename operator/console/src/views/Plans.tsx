import { useState } from "preact/hooks";
import type { Plan } from "../live/model";
import { Badge, Cell, Choice, Empty, Out, Rows, Search, Stale, Time } from "../parts/parts";
import { PLAN_TONES, PLAN_WORDS, planSeconds, planWords } from "../parts/states";
import { filter } from "../search";
import { useItems, useNow, why } from "../state";
import { Checks } from "./Checks";
import { Differences } from "./Differences";
import { duration } from "../words";

type Which = Plan["state"] | "all";
const began = (plan: Plan): number => plan.started_ms ?? plan.demand_seen_ms ?? 0;

/** What managers proposed, and what the gate did with it. */
export function Plans() {
  const plans = [...useItems("plans").values()].sort((one, other) => began(other) - began(one));
  const [text, search] = useState("");
  const [which, choose] = useState<Which>("all");
  const now = useNow();
  const found = filter(text);
  const shown = plans.filter((plan) => (which === "all" || plan.state === which) && found(searched(plan)));
  return (
    <main id="main">
      <h1>Plans</h1>
      <p class="quiet">What managers proposed as pull requests, and what became of it.</p>
      <Stale kinds={["plans"]} now={now} />
      <div class="filters">
        <Search label="Search plans" hint="Words, or release:…, task:…, manager:…" value={text} change={search} />
        <Choice label="Which plans" value={which} choices={choices(plans)} change={choose} />
      </div>
      {shown.length ? (
        <Rows
          label="Plans"
          heads={["Plan", "State", "What and why", "Takes", "Pull request", "Commit", "Began"]}
          items={shown}
          row={(plan) => <Line key={plan.plan} plan={plan} now={now} />}
        />
      ) : (
        <Empty title={plans.length ? "No plan matches." : "No manager has made a plan yet."}>
          {!plans.length && <p class="quiet">A plan is made when tasks ask for releases that are not on main.</p>}
        </Empty>
      )}
    </main>
  );
}

function searched(plan: Plan) {
  return {
    plan: plan.plan,
    subject: plan.subject,
    cause: plan.cause,
    manager: plan.manager,
    task: plan.tasks,
    event: plan.events,
    release: [...plan.created, ...plan.changed, ...plan.removed],
    commit: plan.commit,
  };
}

function choices(plans: readonly Plan[]): [Which, string][] {
  const number = (state: Plan["state"]): number => plans.filter((plan) => plan.state === state).length;
  return [
    ["all", "All"],
    ["open", `Open ${number("open")}`],
    ["merged", `Merged ${number("merged")}`],
    ["observed", `Deployed ${number("observed")}`],
    ["refused", `Refused ${number("refused")}`],
  ];
}

function Line({ plan, now }: { plan: Plan; now: number }) {
  const seconds = planSeconds(plan);
  return (
    <tr>
      <Cell head="Plan">
        <a href={why("plan", plan.plan)}>{plan.plan}</a>
        <div class="quiet">{plan.manager}</div>
      </Cell>
      <Cell head="State">
        <Badge tone={PLAN_TONES[plan.state]}>{PLAN_WORDS[plan.state]}</Badge>
      </Cell>
      <Cell head="What and why" wide>
        {plan.subject}
        <div class="quiet">
          {planWords(plan)} ({plan.cause})
        </div>
        {plan.error && <div class="bad">{plan.error}</div>}
        {plan.waits && <div class="quiet">waits: {plan.waits}</div>}
        <Differences plan={plan} />
        <Checks plan={plan} />
      </Cell>
      <Cell head="Takes">{seconds === undefined ? <span class="quiet">–</span> : duration(seconds)}</Cell>
      <Cell head="Pull request">
        {plan.url ? (
          <Out href={plan.url}>{plan.pull_request}</Out>
        ) : (
          (plan.pull_request ?? <span class="quiet">none yet</span>)
        )}
      </Cell>
      <Cell head="Commit">
        {plan.commit ? (
          <a href={why("commit", plan.commit)}>
            <code>{plan.commit.slice(0, 12)}</code>
          </a>
        ) : (
          <span class="quiet">none yet</span>
        )}
      </Cell>
      <Cell head="Began">
        <Time ms={began(plan) || null} now={now} />
      </Cell>
    </tr>
  );
}
