import { Badge, Cell, Empty, Out, Rows, Time } from "../parts/parts";
import { live, useConnection, useItems, useNow } from "../state";
import { MODE_WORDS } from "../parts/Status";

/** What the page shows comes from these; what is away is shown as of when it was seen last. */
export function Sources() {
  const sources = [...useItems("sources").values()].sort((one, other) => Number(one.ok) - Number(other.ok));
  const connection = useConnection();
  const now = useNow();
  const { forge, argocd } = live.table.links;
  return (
    <main id="main">
      <h1>Sources</h1>
      <p>
        This page: {MODE_WORDS[connection.mode]}. <span class="quiet">{connection.problem}</span>
      </p>
      <p>
        {forge && <Out href={forge}>Forge</Out>} {argocd && <Out href={argocd}>Argo CD</Out>}
      </p>
      {sources.length ? (
        <Rows
          label="Sources"
          heads={["Source", "State", "What to do", "Carries", "Since"]}
          items={sources}
          row={(source) => (
            <tr key={source.name}>
              <Cell head="Source">
                <span class="name">{source.name}</span>
              </Cell>
              <Cell head="State">
                <Badge tone={source.ok ? "good" : "bad"}>{source.ok ? "answers" : "away"}</Badge>
              </Cell>
              <Cell head="What to do" wide>
                {source.problem} <span class="quiet">{source.advice}</span>
              </Cell>
              <Cell head="Carries">{source.carries.join(", ")}</Cell>
              <Cell head="Since">
                <Time ms={source.since_ms} now={now} />
              </Cell>
            </tr>
          )}
        />
      ) : (
        <Empty title="The process has not said yet what it reads from." />
      )}
    </main>
  );
}
