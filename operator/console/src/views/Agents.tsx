import { useState } from "preact/hooks";
import type { Agent, Certificate, Release } from "../live/model";
import { silentSince } from "../map/fleet";
import { Badge, Cell, Empty, Rows, Search, Stale, Time } from "../parts/parts";
import { versionsByDigest } from "../parts/evidence";
import { sharedWords } from "../parts/sharing";
import { Certificates } from "../parts/Certificates";
import { Trial } from "../parts/Trial";
import { filter } from "../search";
import { at, live, useItems, useNow, why } from "../state";
import { clock, count } from "../words";
import { Hold } from "./Fleet";

const HEADS = ["Agent", "State", "Role", "Nodes", "Hold", "Versions"];

/** Every declared agent: its Nodes, what it wants, when it was heard last. */
export function Agents() {
  const agents = [...useItems("agents").values()].sort((one, other) => one.name.localeCompare(other.name));
  const running = new Map<string, [string, Release][]>();
  for (const entry of useItems("releases")) {
    const { agent } = entry[1];
    const known = running.get(agent);
    if (known) known.push(entry);
    else running.set(agent, [entry]);
  }
  const proved = useItems("sources").has("certificates"); // else accounts at the broker have passwords
  const certificates = new Map<string, Certificate[]>();
  for (const certificate of useItems("certificates").values()) {
    const known = certificates.get(certificate.namespace);
    if (known) known.push(certificate);
    else certificates.set(certificate.namespace, [certificate]);
  }
  const versions = versionsByDigest(useItems("catalogue").values());
  const [text, search] = useState("");
  const now = useNow();
  const found = filter(text);
  const shown = agents.filter((agent) => found(searched(agent)));
  return (
    <main id="main">
      <h1>Agents</h1>
      <p class="quiet">{count(agents.length, "agent")} declared by the deployment repository or by labels of Nodes.</p>
      <Stale kinds={["agents", "poses", "certificates"]} now={now} />
      <Trial />
      <div class="filters">
        <Search label="Search agents" hint="Words, or role:…, node:…, capability:…" value={text} change={search} />
      </div>
      {shown.length ? (
        <Rows
          label="Agents"
          heads={[...HEADS, ...(proved ? ["Certificate"] : []), "Position heard"]}
          items={shown}
          row={(agent) => (
            <Line
              key={agent.name}
              agent={agent}
              releases={running.get(agent.namespace) ?? []}
              versions={versions}
              certificates={proved ? (certificates.get(agent.namespace) ?? []) : undefined}
              now={now}
            />
          )}
        />
      ) : (
        <Empty title={agents.length ? "No agent matches." : "No agents are declared."}>
          {!agents.length && <p>Agents are declared by policies/agents.yaml of the deployment repository.</p>}
        </Empty>
      )}
    </main>
  );
}

function searched(agent: Agent) {
  return {
    name: agent.name,
    namespace: agent.namespace,
    role: agent.role,
    capability: agent.capabilities,
    node: agent.nodes.map((node) => node.name),
    hold: agent.hold?.reason,
  };
}

interface LineProperties {
  readonly agent: Agent;
  readonly releases: readonly (readonly [string, Release])[];
  readonly versions: ReadonlyMap<string, string>;
  readonly certificates: readonly Certificate[] | undefined;
  readonly now: number;
}

function Line({ agent, releases, versions, certificates, now }: LineProperties) {
  const pose = live.table.maps.poses.get(agent.name);
  return (
    <tr>
      <Cell head="Agent">
        <a href={at("fleet", agent.name)}>{agent.name}</a>
        {agent.namespace !== agent.name && <div class="quiet">namespace {agent.namespace}</div>}
      </Cell>
      <Cell head="State">
        <State agent={agent} now={now} />
      </Cell>
      <Cell head="Role">
        {agent.role}
        <div class="quiet">{[...agent.capabilities, ...(agent.records ? ["records"] : [])].join(", ")}</div>
      </Cell>
      <Cell head="Nodes">
        {agent.nodes.map((node) => (
          <div key={node.name}>
            {node.name} <span class="quiet">{node.cordoned ? "cordoned" : ""}</span>
            {!node.ready && (
              <span class="bad"> not ready{node.since_ms !== null && ` since ${clock(node.since_ms, now)}`}</span>
            )}
            {node.shared_with.length > 0 && <div class="quiet">{sharedWords(node)}</div>}
          </div>
        ))}
      </Cell>
      <Cell head="Hold">
        <Hold agent={agent} now={now} />
      </Cell>
      <Cell head="Versions">
        <Versions releases={releases} versions={versions} />
      </Cell>
      {certificates && (
        <Cell head="Certificate">
          <Certificates certificates={certificates} now={now} />
        </Cell>
      )}
      <Cell head="Position heard">
        {pose ? <Time ms={pose.received_ms} now={now} /> : <span class="quiet">never</span>}
      </Cell>
    </tr>
  );
}

/** Which charts run there, each in which version: what its digest is in the catalogue. */
function Versions({ releases, versions }: Pick<LineProperties, "releases" | "versions">) {
  if (!releases.length) return <span class="quiet">nothing runs</span>;
  return (
    <details class="changes">
      <summary>{count(releases.length, "release")}</summary>
      <ul>
        {releases.map(([key, release]) => (
          <li key={key}>
            <a href={why("release", key)}>{release.release}</a>{" "}
            <span class="quiet">{versions.get(release.digest) ?? "of no version that the catalogue has"}</span>
          </li>
        ))}
      </ul>
    </details>
  );
}

function State({ agent, now }: { agent: Agent; now: number }) {
  const silent = silentSince(agent, live.table.maps.poses.get(agent.name), now);
  if (!agent.nodes.length) return <Badge tone="quiet">no Node joined</Badge>;
  if (silent !== undefined) return <Badge tone="warn">silent since {clock(silent, now)}</Badge>;
  return agent.ready ? <Badge tone="good">ready</Badge> : <Badge tone="bad">not ready</Badge>;
}
