import type { Mode } from "../live/connection";
import { at, useConnection, useItems } from "../state";
import type { Tone } from "./parts";

export const MODE_WORDS: Record<Mode, string> = {
  starting: "connecting",
  live: "live",
  polling: "asks every 2 s",
  away: "not connected",
  "signed-out": "not signed in",
  forbidden: "no leave to read",
};

const TONES: Record<Mode, Tone> = {
  starting: "busy",
  live: "good",
  polling: "warn",
  away: "bad",
  "signed-out": "bad",
  forbidden: "bad",
};

/** Whether what is shown is live, in a word; leads to what the page reads from. */
export function Status() {
  const connection = useConnection();
  const away = [...useItems("sources").values()].filter((source) => !source.ok);
  const partly = connection.mode === "live" && away.length > 0;
  return (
    <a class={`status ${partly ? "warn" : TONES[connection.mode]}`} href={at("sources")}>
      <span class="dot" aria-hidden="true" />
      <span role="status">
        {partly ? `live without ${away.map((source) => source.name).join(", ")}` : MODE_WORDS[connection.mode]}
      </span>
    </a>
  );
}
