import { useState } from "preact/hooks";
import type { CatalogueEntry } from "../live/model";
import { Badge, Cell, Choice, Empty, Rows, Search, Stale } from "../parts/parts";
import { filter } from "../search";
import { useItems, useNow, why } from "../state";
import { findingWords, followersOf } from "../parts/evidence";
import { count, short } from "../words";

type Which = "all" | CatalogueEntry["kind"] | "running";
const RUNS_MAX = 5;

/** What may run: applications and chart versions, on what evidence, and where they run. */
export function Catalogue() {
  const entries = [...useItems("catalogue")].sort(([, one], [, other]) => order(one, other));
  const [text, search] = useState("");
  const [which, choose] = useState<Which>("all");
  const now = useNow();
  const found = filter(text);
  const followers = followersOf(entries.map(([, entry]) => entry));
  const shown = entries.filter(([, entry]) => chosen(entry, which) && found(searched(entry)));
  const choices: [Which, string][] = [
    ["all", "All"],
    ["application", "Applications"],
    ["chart", "Charts"],
    ["running", "Running"],
  ];
  return (
    <main id="main">
      <h1>Catalogue</h1>
      <p class="quiet">What may run: only what the gate published, with evidence for exactly its digest.</p>
      <Stale kinds={["catalogue", "releases"]} now={now} />
      <div class="filters">
        <Search label="Search the catalogue" hint="Words, or provides:…, digest:…" value={text} change={search} />
        <Choice label="Which entries" value={which} choices={choices} change={choose} />
      </div>
      {shown.length ? (
        <Rows
          label="Catalogue"
          heads={["Name", "Version", "State", "What it is", "Evidence", "Upgrades", "Runs"]}
          items={shown}
          row={([key, entry]) => (
            <Line key={key} entry={entry} next={followers.get(`${entry.name} ${entry.version}`)} />
          )}
        />
      ) : (
        <Empty title={entries.length ? "No entry matches." : "Nothing is published yet."}>
          {!entries.length && (
            <p>
              <code>robotkube registry submit</code> proposes a chart; the gate publishes it when its suites pass.
            </p>
          )}
        </Empty>
      )}
    </main>
  );
}

function order(one: CatalogueEntry, other: CatalogueEntry): number {
  const version = other.version.localeCompare(one.version, undefined, { numeric: true });
  return one.kind.localeCompare(other.kind) || one.name.localeCompare(other.name) || version;
}

function chosen(entry: CatalogueEntry, which: Which): boolean {
  return which === "all" || (which === "running" ? entry.releases.length > 0 : entry.kind === which);
}

function searched(entry: CatalogueEntry) {
  const { name, version, state, description, provides, digest, evidence, channel } = entry;
  const suites = entry.findings.map(({ suite, result }) => `${suite} ${result}`);
  return { name, version, state, description, provides, digest, evidence, channel, suite: suites };
}

function Line({ entry, next }: { entry: CatalogueEntry; next: readonly string[] | undefined }) {
  return (
    <tr>
      <Cell head="Name">
        <span class="name">{entry.name}</span>
        <div class="quiet">{entry.kind}</div>
      </Cell>
      <Cell head="Version">
        {entry.version || <span class="quiet">–</span>}
        {entry.digest && (
          <div class="quiet">
            <code title={entry.digest}>{short(entry.digest)}</code>
          </div>
        )}
      </Cell>
      <Cell head="State">
        <Badge tone={entry.state === "verified" ? "good" : "quiet"}>{entry.state}</Badge>
        <div class="quiet">{entry.channel}</div>
      </Cell>
      <Cell head="What it is" wide>
        {entry.description}
        {entry.provides.length > 0 && <div class="quiet">provides {entry.provides.join(", ")}</div>}
      </Cell>
      <Cell head="Evidence">
        <Evidence entry={entry} />
        <Findings entry={entry} />
      </Cell>
      <Cell head="Upgrades">
        <Upgrades entry={entry} next={next ?? []} />
      </Cell>
      <Cell head="Runs">
        {entry.releases.slice(0, RUNS_MAX).map((release) => (
          <div key={release}>
            <a href={why("release", release)}>{release}</a>
          </div>
        ))}
        {entry.releases.length > RUNS_MAX && (
          <span class="quiet">and {count(entry.releases.length - RUNS_MAX, "other")}</span>
        )}
        {!entry.releases.length && <span class="quiet">{entry.kind === "chart" ? "nowhere" : ""}</span>}
      </Cell>
    </tr>
  );
}

function Evidence({ entry }: { entry: CatalogueEntry }) {
  if (entry.evidence_problem) return <span class="bad">{entry.evidence_problem}</span>;
  if (!entry.evidence) return <span class="quiet">{entry.kind === "chart" ? "none" : ""}</span>;
  return <code title={entry.evidence}>{short(entry.evidence)}</code>;
}

/** What each suite found, and who signed that. */
function Findings({ entry }: { entry: CatalogueEntry }) {
  if (!entry.findings.length) return null;
  const passed = entry.findings.filter(({ result }) => result === "PASSED").length;
  return (
    <details class="changes">
      <summary>
        {passed} of {count(entry.findings.length, "suite")} passed
        <span class="hidden">
          : {entry.name} {entry.version}
        </span>
      </summary>
      <ul>
        {entry.findings.map((finding) => (
          <li key={finding.suite}>
            {finding.suite}: <span class={finding.result === "PASSED" ? "" : "bad"}>{findingWords(finding)}</span>
          </li>
        ))}
      </ul>
      {entry.policy && (
        <p class="quiet">
          under policy <code title={entry.policy}>{short(entry.policy)}</code>
        </p>
      )}
    </details>
  );
}

/** Where a version stands in the graph of upgrades. */
function Upgrades({ entry, next }: { entry: CatalogueEntry; next: readonly string[] }) {
  if (entry.kind !== "chart") return null;
  return (
    <>
      <div>{entry.replaces ? `from ${entry.replaces}` : <span class="quiet">from no other</span>}</div>
      {entry.skips.length > 0 && <div class="quiet">also from {entry.skips.join(", ")}</div>}
      {next.length > 0 && <div>to {next.join(", ")}</div>}
    </>
  );
}
