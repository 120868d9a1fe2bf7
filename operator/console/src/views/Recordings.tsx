import { useEffect, useState } from "preact/hooks";
import type { Recording } from "../live/model";
import { Command } from "../parts/Command";
import { command, exportCommand } from "../parts/terminal";
import { Badge, Cell, Choice, Empty, Rows, Search, Stale, Time, type Tone } from "../parts/parts";
import { filter } from "../search";
import { useItems, useNow, usePlace, why } from "../state";
import { clock, count, duration } from "../words";

type Which = "all" | "open" | "gaps";
const GAPS_MAX = 10;

/** What recorders keep: for which events, since when, on which volume, and what is missing. An address may name one. */
export function Recordings() {
  const recordings = [...useItems("recordings")].sort(
    ([, one], [, other]) => (other.began_ms ?? 0) - (one.began_ms ?? 0),
  );
  const [, name] = usePlace();
  const [text, search] = useState("");
  useEffect(() => search(name ? `name:${name}` : ""), [name]);
  const [which, choose] = useState<Which>("all");
  const now = useNow();
  const found = filter(text);
  const shown = recordings.filter(([, recording]) => OF[which](recording) && found(searched(recording)));
  return (
    <main id="main">
      <h1>Recordings</h1>
      <p class="quiet">
        As their recorders say since this console began. What databases and volumes hold:{" "}
        <code>robotkube recording list</code>. Point clouds lie on the volumes of the agents that record, which no page
        reaches: a command writes the file.
      </p>
      <Stale kinds={["recordings"]} now={now} />
      <div class="filters">
        <Search label="Search recordings" hint="Words, or agent:…, event:…, topic:…" value={text} change={search} />
        <Choice label="Which recordings" value={which} choices={choices(recordings)} change={choose} />
      </div>
      {shown.length ? (
        <Rows
          label="Recordings"
          heads={["Recording", "State", "Windows", "Messages", "Missing", "Volume", "Get it"]}
          items={shown}
          row={([key, recording]) => <Line key={key} name={key} recording={recording} now={now} />}
        />
      ) : (
        <Empty title={recordings.length ? "No recording matches." : "No recorder is at work."}>
          {!recordings.length && (
            <p>
              Event detectors record when a reaction of theirs says so. Older recordings:{" "}
              <code>robotkube recording list</code>.
            </p>
          )}
        </Empty>
      )}
    </main>
  );
}

const OF: Record<Which, (recording: Recording) => boolean> = {
  all: () => true,
  open: (recording) => recording.at_work,
  gaps: (recording) => recording.gap_count > 0 || recording.dropped > 0,
};

function choices(recordings: readonly (readonly [string, Recording])[]): [Which, string][] {
  const number = (which: Which): number => recordings.filter(([, recording]) => OF[which](recording)).length;
  return [
    ["all", "All"],
    ["open", `At work ${number("open")}`],
    ["gaps", `With gaps ${number("gaps")}`],
  ];
}

function searched(recording: Recording) {
  return {
    name: recording.recording,
    agent: recording.agent,
    rule: recording.rule,
    volume: recording.volume,
    event: recording.windows.map((window) => window.event),
    topic: recording.topics.map((topic) => topic.topic),
  };
}

function state(recording: Recording): [Tone, string] {
  if (recording.at_work) return ["busy", "at work"];
  return recording.ended_ms === null ? ["quiet", "recorder is gone"] : ["good", "ended"];
}

/** Where the process has the layout of the recording of a key. */
const layoutOf = (key: string): string => `api/recordings/${key.split("/").map(encodeURIComponent).join("/")}/layout`;

function Line({ name, recording, now }: { name: string; recording: Recording; now: number }) {
  const [tone, word] = state(recording);
  return (
    <tr>
      <Cell head="Recording">
        <a href={why("recording", name)}>{recording.recording}</a>
        <div class="quiet">
          <a href={why("pod", recording.detector)}>{recording.detector}</a>
        </div>
      </Cell>
      <Cell head="State">
        <Badge tone={tone}>{word}</Badge>
        <div>
          <Time ms={recording.began_ms} now={now} />
        </div>
        <div class="quiet">{took(recording, now)}</div>
      </Cell>
      <Cell head="Windows">
        <Windows recording={recording} now={now} />
      </Cell>
      <Cell head="Messages">
        {count(recording.stored, "stored", "stored")}
        <div class="quiet">of {recording.received.toLocaleString("en-GB")} received</div>
        <details class="changes">
          <summary>{count(recording.topics.length, "topic")}</summary>
          <ul>
            {recording.topics.map((topic) => (
              <li key={topic.topic}>
                <code>{topic.topic}</code> {topic.stored.toLocaleString("en-GB")}
              </li>
            ))}
          </ul>
        </details>
      </Cell>
      <Cell head="Missing" wide>
        <Missing recording={recording} now={now} />
      </Cell>
      <Cell head="Volume">
        <code>{recording.volume}</code>
      </Cell>
      <Cell head="Get it" wide>
        <a href={layoutOf(name)} download>
          Layout<span class="hidden"> of {recording.recording}</span> for Foxglove or Lichtblick
        </a>
        <div>
          <Command text={exportCommand(recording.recording)} />
        </div>
        <div class="quiet">writes the MCAP file, where {recording.volume} is in reach</div>
      </Cell>
    </tr>
  );
}

function took(recording: Recording, now: number): string {
  if (recording.began_ms === null) return "";
  if (recording.ended_ms !== null) return `for ${duration((recording.ended_ms - recording.began_ms) / 1000)}`;
  return recording.at_work
    ? `for ${duration(Math.floor((now - recording.began_ms) / 1000))} so far`
    : "its end was not seen";
}

function Windows({ recording, now }: { recording: Recording; now: number }) {
  if (!recording.windows.length) return <span class="quiet">all the time ({recording.rule})</span>;
  return (
    <>
      {recording.windows.map((window) => (
        <div key={window.event}>
          <a href={why("event", window.event)}>{recording.rule}</a>{" "}
          <span class="quiet">
            {window.began_ms !== null && clock(window.began_ms, now)}
            {window.ended_ms === null ? ", lasts" : ` to ${clock(window.ended_ms, now)}`}
          </span>
        </div>
      ))}
    </>
  );
}

function Missing({ recording, now }: { recording: Recording; now: number }) {
  const { gap_count: gaps, dropped } = recording;
  if (!gaps && !dropped)
    return (
      <span class="quiet">{recording.at_work ? "nothing reported; holes are looked for at its end" : "nothing"}</span>
    );
  return (
    <>
      <span class="bad">
        {[gaps && count(gaps, "gap"), dropped && `${dropped.toLocaleString("en-GB")} dropped`]
          .filter(Boolean)
          .join(", ")}
      </span>
      <details class="changes">
        <summary>Where and why</summary>
        <ul>
          {recording.gaps.slice(0, GAPS_MAX).map((gap, index) => (
            <li key={index}>
              <code>{gap.topic}</code> {gap.count === null ? "nobody knows how many" : count(gap.count, "message")},{" "}
              {gap.where}: {gap.why}
              {gap.first_ms !== null && <span class="quiet"> from {clock(gap.first_ms, now)}</span>}
            </li>
          ))}
        </ul>
        {gaps > GAPS_MAX && (
          <p class="quiet">
            and {count(gaps - GAPS_MAX, "other")}:{" "}
            <code>{command("robotkube", "recording", "verify", recording.recording)}</code>
          </p>
        )}
      </details>
    </>
  );
}
