import { useMemo, useState } from "preact/hooks";
import type { Agent, RuleEvent } from "../live/model";
import { silentSince } from "../map/fleet";
import { FleetMap } from "../map/Map";
import { linksInWords } from "../parts/links";
import { Badge, Choice, Empty, Search, Stale } from "../parts/parts";
import { Trial } from "../parts/Trial";
import { filter } from "../search";
import { at, go, live, useItems, useNow, usePlace, useSignature, why } from "../state";
import { age, ago, clock, count, duration } from "../words";
import { AgentCard } from "./AgentCard";

const LIST_MAX = 150;
const EVENTS_MAX = 30;
type Which = "all" | "silent" | "events" | "held";

/** Agents from above and in a list, events as they happen, and what one agent is doing. */
export function Fleet() {
  const [, selected] = usePlace();
  const [text, search] = useState("");
  const [which, choose] = useState<Which>("all");
  const now = useNow();
  const rows = useFleet(now);
  const shown = useMemo(() => chosen(rows, text, which), [rows, text, which]);
  const all = !text.trim() && which === "all";
  const names = useMemo(() => (all ? undefined : new Set(shown.map((row) => row.name))), [shown, all]);
  const select = (name: string | undefined): void => go(name === undefined ? at("fleet") : at("fleet", name));
  return (
    <main id="main" class="fleet">
      <h1 class="hidden">Fleet</h1>
      <FleetMap found={names} selected={selected} select={select} empty={!rows.some((row) => row.heard)} />
      <aside aria-label="Agents and events">
        <Stale kinds={["agents", "poses", "events", "rules", "links"]} now={now} />
        {selected !== undefined && <AgentCard name={selected} now={now} close={() => select(undefined)} />}
        <Events now={now} />
        <section aria-labelledby="agents-head">
          <h2 id="agents-head">{count(rows.length, "agent")}</h2>
          <Trial />
          <Search label="Search agents" hint="Words, or role:vehicle, runs:recorder" value={text} change={search} />
          <Choice label="Which agents" value={which} choices={choices(rows)} change={choose} />
          <AgentList rows={shown} selected={selected} now={now} />
        </section>
      </aside>
    </main>
  );
}

interface Row {
  readonly name: string;
  readonly role: string;
  readonly silent: number | undefined;
  readonly events: readonly string[];
  readonly hold: string;
  readonly runs: readonly string[];
  readonly links: string;
  readonly heard: boolean;
}

/** One row per agent that is declared or heard. */
function useFleet(now: number): readonly Row[] {
  const { agents, poses, events, releases, links } = live.table.maps;
  const { changed } = live.table;
  useSignature(() => ["agents", "events", "releases", "links"].map((kind) => changed.get(kind as "agents")).join());
  const running = useMemo(() => grouped(releases.values(), (release) => [release.agent]), [changed.get("releases")]);
  const carried = useMemo(() => grouped(links.values(), (link) => [link.agent]), [changed.get("links")]);
  const versions = [changed.get("agents"), changed.get("events"), running, carried, Math.floor(now / 1000)];
  return useMemo(() => {
    const lasting = grouped(
      [...events.values()].filter((event) => event.ended_ms === null),
      (event) => event.agents,
    );
    const names = new Set([...agents.keys(), ...poses.keys()]);
    return [...names].sort().map((name) => {
      const agent = agents.get(name);
      return {
        name,
        role: agent?.role ?? "",
        silent: silentSince(agent, poses.get(name), now),
        events: (lasting.get(name) ?? []).map((event) => event.rule),
        hold: agent?.hold?.reason ?? "",
        runs: (running.get(agent?.namespace ?? name) ?? []).map((release) => release.chart),
        links: linksInWords(carried.get(agent?.namespace ?? name) ?? []),
        heard: poses.has(name),
      };
    });
  }, versions);
}

function grouped<T>(items: Iterable<T>, keys: (item: T) => readonly string[]): Map<string, T[]> {
  const groups = new Map<string, T[]>();
  for (const item of items)
    for (const key of keys(item)) {
      const group = groups.get(key);
      if (group) group.push(item);
      else groups.set(key, [item]);
    }
  return groups;
}

function chosen(rows: readonly Row[], text: string, which: Which): readonly Row[] {
  const found = filter(text);
  return rows.filter(
    (row) => OF[which](row) && found({ name: row.name, role: row.role, runs: row.runs, hold: row.hold }),
  );
}

const OF: Record<Which, (row: Row) => boolean> = {
  all: () => true,
  silent: (row) => row.silent !== undefined,
  events: (row) => row.events.length > 0,
  held: (row) => row.hold !== "",
};

function choices(rows: readonly Row[]): [Which, string][] {
  const number = (which: Which): number => rows.filter(OF[which]).length;
  return [
    ["all", "All"],
    ["events", `In events ${number("events")}`],
    ["silent", `Silent ${number("silent")}`],
    ["held", `On hold ${number("held")}`],
  ];
}

function AgentList({ rows, selected, now }: { rows: readonly Row[]; selected: string | undefined; now: number }) {
  if (!live.table.maps.agents.size)
    return (
      <Empty title="No agents are declared.">
        <p>Agents are declared by policies/agents.yaml of the deployment repository, and by labels of Nodes.</p>
      </Empty>
    );
  if (!rows.length) return <Empty title="No agent matches." />;
  return (
    <ul class="agents">
      {rows.slice(0, LIST_MAX).map((row) => (
        <li key={row.name}>
          <a href={at("fleet", row.name)} aria-current={row.name === selected ? "true" : undefined}>
            <span class="name">{row.name}</span> <span class="quiet">{row.role}</span>{" "}
            <AgentState row={row} now={now} />
            {row.links && <span class="links quiet">{row.links}</span>}
          </a>
        </li>
      ))}
      {rows.length > LIST_MAX && (
        <li class="quiet">and {count(rows.length - LIST_MAX, "more", "more")}: search for them</li>
      )}
    </ul>
  );
}

function AgentState({ row, now }: { row: Row; now: number }) {
  if (row.silent !== undefined) return <Badge tone="quiet">silent {age(row.silent, now)}</Badge>;
  if (row.events.length) return <Badge tone="busy">{row.events[0]}</Badge>;
  if (row.hold) return <Badge tone="warn">on hold</Badge>;
  return row.heard ? null : <Badge tone="quiet">no position</Badge>;
}

function Events({ now }: { now: number }) {
  const all = [...useItems("events").values()].sort(byBeginning);
  const lasting = all.filter((event) => event.ended_ms === null).length;
  const events = all.slice(0, EVENTS_MAX);
  return (
    <section aria-labelledby="events-head">
      <h2 id="events-head">Events {lasting > 0 && <Badge tone="busy">{count(lasting, "now", "now")}</Badge>}</h2>
      {events.length ? (
        <ol class="events" aria-live="polite" aria-relevant="additions">
          {events.map((event) => (
            <EventLine key={event.id} event={event} now={now} />
          ))}
        </ol>
      ) : (
        <Empty title="No events yet.">
          <p class="quiet">An event appears here when a rule of an event detector begins to hold.</p>
        </Empty>
      )}
    </section>
  );
}

function byBeginning(one: RuleEvent, other: RuleEvent): number {
  return (other.began_ms ?? 0) - (one.began_ms ?? 0) || one.id.localeCompare(other.id);
}

function EventLine({ event, now }: { event: RuleEvent; now: number }) {
  const lasts = event.ended_ms === null;
  const began = event.began_ms;
  return (
    <li class={lasts ? "lasts" : ""}>
      <a href={why("event", event.id)}>
        <span class="name">{event.rule}</span> {event.agents.join(", ")}
        <span class="when quiet">
          {began === null ? "" : lasts ? ago(began, now) : `${clock(began, now)}, ${lasted(began, event.ended_ms)}`}
          {event.distance_m !== null && `, at ${Math.round(event.distance_m)} m`}
        </span>
        {event.error && <span class="bad"> {event.error}</span>}
      </a>
    </li>
  );
}

const lasted = (began: number, ended: number | null): string =>
  ended === null ? "" : `for ${duration((ended - began) / 1000)}`;

/** Whether an agent holds changes, with why and until when. */
export function Hold({ agent, now }: { agent: Agent; now: number }) {
  if (!agent.hold) return <span class="quiet">none</span>;
  return (
    <>
      {agent.hold.reason}, until {clock(agent.hold.until_ms, now)}
    </>
  );
}
