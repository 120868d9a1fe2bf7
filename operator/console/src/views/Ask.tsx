import { useState } from "preact/hooks";
import { commandOf, fieldsOf, parametersOf, type Field } from "../form";
import { explain, Refused, submitTask } from "../live/api";
import type { CatalogueEntry, Explanation, TaskRequest } from "../live/model";
import { Command } from "../parts/Command";
import { Explained } from "../parts/Explained";
import { Empty, Stale, Words } from "../parts/parts";
import { Policies } from "../parts/Policies";
import { at, go, useItems, useNow, usePlace, useSession, why } from "../state";

const REASON_CHARACTERS_MAX = 200;

/** The form that asks for an application: its parameters, what would happen, and then asking. */
export function Ask() {
  const [, , chosen = ""] = usePlace();
  const now = useNow();
  const applications = [...useItems("catalogue").values()].filter((entry) => entry.kind === "application");
  const application = applications.find((entry) => entry.name === chosen);
  const names = applications.map((entry) => entry.name).sort();
  return (
    <main id="main" class="form">
      <p>
        <a href={at("tasks")}>Tasks</a>
      </p>
      <h1>Ask for an application</h1>
      <p class="quiet">See what would happen first. Nothing changes before you submit.</p>
      <Stale kinds={["catalogue", "agents"]} now={now} />
      {names.length ? (
        <Labelled label="Application" hint={application?.description ?? "What may be asked for."}>
          <select
            value={application?.name ?? ""}
            onChange={(event) => go(at("tasks", "ask", event.currentTarget.value))}
          >
            <option value="" disabled>
              Choose one
            </option>
            {names.map((name) => (
              <option key={name}>{name}</option>
            ))}
          </select>
        </Labelled>
      ) : (
        <Empty title="The catalogue has no application yet.">
          <p>
            <code>robotkube registry submit</code> proposes one.
          </p>
        </Empty>
      )}
      <Policies />
      {application && <Parameters key={application.name} application={application} />}
    </main>
  );
}

interface Answer {
  readonly to: string;
  readonly explanation: Explanation;
}

function Parameters({ application }: { application: CatalogueEntry }) {
  const session = useSession();
  const agents = [...useItems("agents").values()].map((agent) => agent.namespace).sort();
  const namespaces = session?.may_write ? session.namespaces : [...new Set(agents)];
  const [texts, type] = useState<Record<string, string>>({});
  const [named, name] = useState("");
  const [answer, answered] = useState<Answer>();
  const [problems, say] = useState<readonly string[]>([]);
  const [busy, work] = useState(false);
  const fields = fieldsOf(application.parameters);
  const [parameters, unread] = parametersOf(fields, texts);
  const namespace = namespaces.includes(named) ? named : (namespaces[0] ?? "");
  const request: TaskRequest = { namespace, application: application.name, parameters };
  if (texts[" reason"]?.trim()) request.reason = texts[" reason"].trim();
  const asked = JSON.stringify(request);
  const current = answer?.to === asked ? answer.explanation : undefined;

  const attempt = async (doing: (csrf: string) => Promise<void>): Promise<void> => {
    if (unread.length) return say(unread);
    work(true);
    say([]);
    try {
      await doing(session?.csrf ?? "");
    } catch (error) {
      say([error instanceof Refused ? `${error.title}: ${error.message}` : String(error)]);
    }
    work(false);
  };
  const see = (event: Event): void => {
    event.preventDefault();
    void attempt(async (csrf) => answered({ to: asked, explanation: await explain(request, csrf) }));
  };
  const submit = (): void => void attempt(async (csrf) => go(why("task", (await submitTask(request, csrf)).task)));
  return (
    <form onSubmit={see} novalidate>
      <Labelled label="In whose name" hint="The agent in whose namespace the task stands.">
        <select value={namespace} onChange={(event) => name(event.currentTarget.value)}>
          {namespaces.map((each) => (
            <option key={each}>{each}</option>
          ))}
        </select>
      </Labelled>
      {fields.map((field) => (
        <Input
          key={field.name}
          field={field}
          value={texts[field.name] ?? ""}
          change={(text) => type({ ...texts, [field.name]: text })}
        />
      ))}
      <Labelled label="Reason" hint="One line for people; the subject of the commit.">
        <input
          type="text"
          maxLength={REASON_CHARACTERS_MAX}
          value={texts[" reason"] ?? ""}
          onInput={(event) => type({ ...texts, " reason": event.currentTarget.value })}
        />
      </Labelled>
      <div role="alert">
        {problems.map((problem) => (
          <p key={problem} class="bad">
            <Words text={problem} />
          </p>
        ))}
      </div>
      <p class="buttons">
        <button type="submit" disabled={busy}>
          See what would happen
        </button>
        {session?.may_write && (
          <button type="button" class="button" disabled={busy || !current} onClick={submit}>
            Submit
          </button>
        )}
      </p>
      {session?.may_write && !current && (
        <p class="quiet">Submit becomes possible when you have seen what would happen.</p>
      )}
      <div aria-live="polite">{current && <Explained answer={current} />}</div>
      {session && !session.may_write && (
        <NotHere why={session.why_not} command={commandOf(namespace, application.name, parameters)} />
      )}
    </form>
  );
}

/** Who may not submit here is told why, and the command that does. */
export function NotHere({ why: reason, command }: { why: string; command: string }) {
  return (
    <div class="empty">
      <p>
        <strong>You cannot submit here.</strong> <Words text={reason} />
      </p>
      <p>
        On a terminal: <Command text={command} />
      </p>
    </div>
  );
}

function Labelled({ label, hint, children }: { label: string; hint: string; children: preact.ComponentChildren }) {
  return (
    <label class="field">
      <span class="name">{label}</span>
      {children}
      <span class="quiet">{hint}</span>
    </label>
  );
}

const PLACES: Partial<Record<Field["kind"], string>> = {
  list: "with commas between",
  json: "JSON",
};

function Input({ field, value, change }: { field: Field; value: string; change: (text: string) => void }) {
  const choices = field.kind === "truth" ? ["true", "false"] : field.choices;
  const words = [field.hint, PLACES[field.kind], field.example && `such as ${field.example}`].filter(Boolean);
  const shared = { value, required: field.required, "aria-required": field.required };
  return (
    <Labelled label={`${field.name}${field.required ? "" : " (not needed)"}`} hint={words.join("; ")}>
      {choices.length ? (
        <select {...shared} onChange={(event) => change(event.currentTarget.value)}>
          <option value="">{field.required ? "Choose one" : "as it is by default"}</option>
          {choices.map((choice) => (
            <option key={choice}>{choice}</option>
          ))}
        </select>
      ) : field.kind === "json" ? (
        <textarea {...shared} rows={4} spellcheck={false} onInput={(event) => change(event.currentTarget.value)} />
      ) : (
        <input
          {...shared}
          type="text"
          inputMode={field.kind === "number" ? "decimal" : "text"}
          autocomplete="off"
          spellcheck={false}
          onInput={(event) => change(event.currentTarget.value)}
        />
      )}
    </Labelled>
  );
}
