import { Badge, Cell, Empty, Rows, Stale, Time } from "../parts/parts";
import { Policies } from "../parts/Policies";
import { useItems, useNow, why } from "../state";
import { clock, count } from "../words";

/** What should not be: strangers on nodes, evidence that does not hold, what the gate refused. */
export function Trust() {
  const now = useNow();
  return (
    <main id="main">
      <h1>Trust</h1>
      <p class="quiet">
        What should not be: what runs without leave, evidence that does not hold, what the gate refused.
      </p>
      <Stale kinds={["strangers", "catalogue", "plans"]} now={now} />
      <Strangers now={now} />
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
