import type { Plan } from "../live/model";
import { why } from "../state";
import { count } from "../words";

type Value = NonNullable<Plan["differences"]>["values"][number];

/** What a plan changes: release by release, each value before and after. */
export function Differences({ plan }: { plan: Plan }) {
  const { differences } = plan;
  if (!differences)
    return <div class="quiet">Which values changed is not remembered any more; its commit has them.</div>;
  if (!differences.values.length) return null;
  const releases = [...new Set(differences.values.map((value) => value.release))];
  return (
    <details class="changes">
      <summary>
        What changes: {count(differences.values.length + differences.more, "value")}
        {differences.more === 0 && ` of ${count(releases.length, "release")}`}
      </summary>
      {releases.map((release) => (
        <div key={release}>
          <a href={why("release", release)}>{release}</a>
          <ul>
            {differences.values
              .filter((value) => value.release === release)
              .map((value) => (
                <li key={value.path}>
                  <Change value={value} />
                </li>
              ))}
          </ul>
        </div>
      ))}
      {differences.more > 0 && <p class="quiet">and {count(differences.more, "other value")}, in its commit</p>}
    </details>
  );
}

function Change({ value }: { value: Value }) {
  return (
    <>
      <span class="quiet">{value.path}</span>{" "}
      {value.before === null ? <span class="quiet">(not there)</span> : <code class="goes">{value.before}</code>}
      <span class="hidden"> becomes </span>
      <span aria-hidden="true"> → </span>
      {value.after === null ? <span class="quiet">(gone)</span> : <code class="comes">{value.after}</code>}
    </>
  );
}
