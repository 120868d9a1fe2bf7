import { useEffect, useState } from "preact/hooks";
import { explain, Refused, withdrawTask } from "../live/api";
import type { Explanation } from "../live/model";
import { command } from "../parts/terminal";
import { Explained } from "../parts/Explained";
import { Words } from "../parts/parts";
import { at, go, useItems, useSession, why } from "../state";
import { NotHere } from "./Ask";

/** Taking a task back: what would happen, and then the button. */
export function Withdraw({ task }: { task: string }) {
  const session = useSession();
  const present = useItems("tasks").get(task);
  const [answer, set] = useState<Explanation>();
  const [problem, say] = useState("");
  const [busy, work] = useState(false);
  const failed = (error: unknown): void =>
    say(error instanceof Refused ? `${error.title}: ${error.message}` : String(error));
  useEffect(() => {
    if (session) explain({ withdraw: task }, session.csrf ?? "").then(set, failed);
  }, [task, session]);
  const withdraw = (): void => {
    work(true);
    withdrawTask(task, session?.csrf ?? "")
      .then(() => go(why("task", task)), failed)
      .finally(() => work(false));
  };
  const may = session?.may_write && session.namespaces.includes(task.split("/")[0] ?? "");
  return (
    <main id="main" class="form">
      <p>
        <a href={at("tasks")}>Tasks</a>
      </p>
      <h1>Withdraw {task}</h1>
      <p class="quiet">
        {present
          ? `${present.application}, asked for by ${present.requester}: ${present.reason || "no reason given"}`
          : "There is no task of this name (any more)."}
      </p>
      <div role="alert">
        {problem && (
          <p class="bad">
            <Words text={problem} />
          </p>
        )}
      </div>
      <div aria-live="polite">
        {answer ? <Explained answer={answer} /> : !problem && <p>The manager is asked what would happen …</p>}
      </div>
      {may && present && (
        <p class="buttons">
          <button type="button" class="button" disabled={busy || !answer} onClick={withdraw}>
            Withdraw it
          </button>
          <a href={at("tasks")}>Leave it</a>
        </p>
      )}
      {session && !may && (
        <NotHere
          why={session.why_not || `Your groups may ask for tasks in ${session.namespaces.join(", ")} alone.`}
          command={command("robotkube", "task", "withdraw", task)}
        />
      )}
    </main>
  );
}
