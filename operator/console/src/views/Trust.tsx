import type { Unchecked } from "../live/model";
import { Badge, Cell, Empty, Rows, Stale, Time } from "../parts/parts";
import { Policies } from "../parts/Policies";
import { uncheckedState } from "../parts/states";
import { useItems, useNow, why } from "../state";
import { clock, count } from "../words";

/** What should not be: strangers on nodes, commits that nobody checked, evidence that does not hold, what the gate refused. */
export function Trust() {
  const now = useNow();
  return (
    <main id="main">
      <h1>Trust</h1>
      <p class="quiet">
        What should not be: what runs without leave, what came to main past the gate, evidence that does not hold, what
        the gate refused.
      </p>
      <Stale kinds={["strangers", "unchecked", "catalogue", "plans"]} now={now} />
      <Strangers now={now} />
      <UncheckedCommits now={now} />
      <BadEvidence />
      <Refused now={now} />
      <Policies />
    </main>
  );
}

function Strangers({ now }: { now: number }) {
  const strangers = [...useItems("strangers")];
  return (
    <section aria-labelledby="strangers-head">
      <h2 id="strangers-head">Strangers</h2>
      {strangers.length ? (
        <Rows
          label="What runs without leave"
          heads={["What", "Where", "Why it may not run", "Since"]}
          items={strangers}
          row={([key, stranger]) => (
            <tr key={key}>
              <Cell head="What">
                <span class="name">
                  {stranger.namespace}/{stranger.name}
                </span>
                <div class="quiet">
                  {stranger.kind} {stranger.container}
                </div>
              </Cell>
              <Cell head="Where">{stranger.place}</Cell>
              <Cell head="Why it may not run" wide>
                <Badge tone="bad">{stranger.reason}</Badge>
                <div>{stranger.message}</div>
              </Cell>
              <Cell head="Since">
                <Time ms={stranger.since_ms} now={now} />
              </Cell>
            </tr>
          )}
        />
      ) : (
        <NoStrangers now={now} />
      )}
    </section>
  );
}

/** Nothing is only said to be well as of when it was looked at. */
function NoStrangers({ now }: { now: number }) {
  const source = [...useItems("sources").values()].find((each) => each.carries.includes("strangers"));
  if (!source)
    return (
      <Empty title="Nobody has looked yet.">
        <p class="quiet">The inspector says what runs on nodes that may not.</p>
      </Empty>
    );
  return <Empty title={`Nothing runs that may not, as of ${clock(source.ok ? now : source.since_ms, now)}.`} />;
}

const standing = (each: Unchecked): boolean => !each.made_good;

/** Commits of main that the gate did not check: break-glass, and what was brought past it. */
function UncheckedCommits({ now }: { now: number }) {
  const commits = [...useItems("unchecked")].sort(
    ([, one], [, other]) =>
      Number(standing(other)) - Number(standing(one)) || (other.time_ms ?? now) - (one.time_ms ?? now),
  );
  return (
    <section aria-labelledby="unchecked-head">
      <h2 id="unchecked-head">Break-glass, and other commits past the gate</h2>
      {commits.length ? (
        <Rows
          label="Commits of main that the gate did not check"
          heads={["Commit", "State", "Who and why", "Files that stand", "Signed"]}
          items={commits}
          row={([key, commit]) => <UncheckedLine key={key} commit={commit} now={now} />}
        />
      ) : (
        <NoneUnchecked now={now} />
      )}
    </section>
  );
}

function UncheckedLine({ commit, now }: { commit: Unchecked; now: number }) {
  const state = uncheckedState(commit);
  return (
    <tr>
      <Cell head="Commit">
        {commit.commit ? <code>{commit.commit.slice(0, 12)}</code> : <span class="quiet">all of main</span>}
      </Cell>
      <Cell head="State">
        <Badge tone={state.tone}>{state.words}</Badge>
      </Cell>
      <Cell head="Who and why" wide>
        {commit.reason}
        {commit.signed_by.length > 0 && (
          <div class="quiet">
            {commit.how === "break-glass" ? "signed by" : "names"} {commit.signed_by.join(", ")}
          </div>
        )}
        {commit.problem && <div class="bad">{commit.problem}</div>}
      </Cell>
      <Cell head="Files that stand">
        {commit.files.length ? (
          <details class="changes">
            <summary>{count(commit.files.length, "file")}</summary>
            <ul>
              {commit.files.map((file) => (
                <li key={file}>
                  <code>{file}</code>
                </li>
              ))}
            </ul>
          </details>
        ) : (
          <span class="quiet">none</span>
        )}
      </Cell>
      <Cell head="Signed">
        <Time ms={commit.time_ms} now={now} />
      </Cell>
    </tr>
  );
}

/** Only said as of when the gate had read main. */
function NoneUnchecked({ now }: { now: number }) {
  const source = useItems("sources").get("gate-pages");
  if (!source)
    return <Empty title="The gate's pages are not read here: robotkube status says what stands unchecked." />;
  if (!source.ok) return <Empty title={`The gate has not said so since ${clock(source.since_ms, now)}.`} />;
  return <Empty title={`Everything on main was checked by the gate, as of ${clock(now, now)}.`} />;
}

function BadEvidence() {
  const entries = [...useItems("catalogue")].filter(([, entry]) => entry.evidence_problem);
  return (
    <section aria-labelledby="evidence-head">
      <h2 id="evidence-head">Evidence that does not hold</h2>
      {entries.length ? (
        <ul>
          {entries.map(([key, entry]) => (
            <li key={key}>
              <span class="name">
                {entry.name} {entry.version}
              </span>
              : <span class="bad">{entry.evidence_problem}</span>{" "}
              {entry.releases.length > 0 && <>It runs as {count(entry.releases.length, "release")}.</>}
            </li>
          ))}
        </ul>
      ) : (
        <Empty title="No entry of the catalogue has evidence that does not hold." />
      )}
    </section>
  );
}

function Refused({ now }: { now: number }) {
  const plans = [...useItems("plans").values()].filter((plan) => plan.state === "refused");
  return (
    <section aria-labelledby="refused-head">
      <h2 id="refused-head">Refused plans</h2>
      {plans.length ? (
        <ul>
          {plans.map((plan) => (
            <li key={plan.plan}>
              <a href={why("plan", plan.plan)}>{plan.subject || plan.plan}</a>{" "}
              <span class="quiet">
                <Time ms={plan.proposed_ms ?? plan.started_ms} now={now} />
              </span>
              <div class="bad">{plan.error}</div>
            </li>
          ))}
        </ul>
      ) : (
        <Empty title="No plan that managers remember was refused." />
      )}
    </section>
  );
}
