import { useState } from "preact/hooks";
import type { Task } from "../live/model";
import { Badge, Cell, Choice, Empty, Out, Rows, Search, Stale, Time, Words } from "../parts/parts";
import { TASK_TONES, taskGroup, taskWords, type TaskGroup } from "../parts/states";
import { filter } from "../search";
import { at, useItems, useNow, usePlace, useSession, why } from "../state";
import { Ask } from "./Ask";
import { Withdraw } from "./Withdraw";

type Which = TaskGroup | "all";

/** Tasks: the list of them, the form that asks for one, or the question whether one is taken back. */
export function Tasks() {
  const [, what, ...words] = usePlace();
  if (what === "ask") return <Ask />;
  return what === "withdraw" ? <Withdraw key={words.join("/")} task={words.join("/")} /> : <List />;
}

/** What is asked for, what became of it, and why it waits. */
function List() {
  const tasks = [...useItems("tasks")].sort(([, one], [, other]) => (other.created_ms ?? 0) - (one.created_ms ?? 0));
  const [text, search] = useState("");
  const [which, choose] = useState<Which>("all");
  const now = useNow();
  const session = useSession();
  const found = filter(text);
  const shown = tasks.filter(([, task]) => (which === "all" || taskGroup(task) === which) && found(searched(task)));
  return (
    <main id="main">
      <h1>Tasks</h1>
      <p class="quiet">
        What is asked for, and what became of it. {session && !session.may_write && <Words text={session.why_not} />}
      </p>
      <p>
        <a class="button" href={at("tasks", "ask")}>
          Ask for an application
        </a>
      </p>
      <Stale kinds={["tasks"]} now={now} />
      <div class="filters">
        <Search label="Search tasks" hint="Words, or application:…, agent:…, asks:…" value={text} change={search} />
        <Choice label="Which tasks" value={which} choices={choices(tasks.map(([, task]) => task))} change={choose} />
      </div>
      {shown.length ? (
        <Rows
          label="Tasks"
          heads={["Task", "State", "Why", "Asked by", "Event", "Plan", "Created"]}
          items={shown}
          row={([key, task]) => <Line key={key} name={key} task={task} now={now} />}
        />
      ) : (
        <None any={tasks.length > 0} />
      )}
    </main>
  );
}

function None({ any }: { any: boolean }) {
  if (any) return <Empty title="No task matches." />;
  return (
    <Empty title="Nobody asks for anything.">
      <p>
        A rule of an event detector asks when it begins to hold, a person here or with{" "}
        <code>robotkube task submit</code>.
      </p>
    </Empty>
  );
}

function searched(task: Task) {
  return {
    name: `${task.namespace}/${task.name}`,
    application: task.application,
    reason: task.reason,
    asks: task.requester,
    state: task.state,
    agent: task.agents,
    rule: task.event.rule,
    plan: task.plan,
  };
}

function choices(tasks: readonly Task[]): [Which, string][] {
  const number = (group: TaskGroup): number => tasks.filter((task) => taskGroup(task) === group).length;
  return [
    ["all", "All"],
    ["active", `Run ${number("active")}`],
    ["waiting", `Wait ${number("waiting")}`],
    ["refused", `Refused ${number("refused")}`],
    ["withdrawn", `Withdrawn ${number("withdrawn")}`],
  ];
}

function Line({ name, task, now }: { name: string; task: Task; now: number }) {
  return (
    <tr>
      <Cell head="Task">
        <a href={why("task", name)}>{name}</a>
        <div class="quiet">{task.application}</div>
      </Cell>
      <Cell head="State">
        <Badge tone={TASK_TONES[taskGroup(task)]}>{task.state}</Badge>
        {!task.withdrawn && (
          <div>
            <a href={at("tasks", "withdraw", task.namespace, task.name)} aria-label={`Withdraw ${name}`}>
              Withdraw …
            </a>
          </div>
        )}
      </Cell>
      <Cell head="Why" wide>
        {task.reason}
        <div class="quiet">{taskWords(task)}</div>
      </Cell>
      <Cell head="Asked by">
        {task.requester}
        <div class="quiet">priority {task.priority}</div>
      </Cell>
      <Cell head="Event">
        {task.event.id ? (
          <a href={why("event", task.event.id)}>{task.event.rule || task.event.id}</a>
        ) : (
          <span class="quiet">none</span>
        )}
      </Cell>
      <Cell head="Plan">
        {task.plan ? <a href={why("plan", task.plan)}>{task.plan}</a> : <span class="quiet">none yet</span>}
        {task.pull_request?.url && (
          <div>
            <Out href={task.pull_request.url}>pull request {task.pull_request.number}</Out>
          </div>
        )}
      </Cell>
      <Cell head="Created">
        <Time ms={task.created_ms} now={now} />
      </Cell>
    </tr>
  );
}
