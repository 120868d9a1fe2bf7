/** Small parts that several views share. */
import type { ComponentChildren } from "preact";
import { useState } from "preact/hooks";
import type { Source } from "../live/model";
import { useItems } from "../state";
import { ago, clock, count } from "../words";

export type Tone = "good" | "bad" | "warn" | "quiet" | "busy";

/** A state in a word or two; the word says it, the colour only helps. */
export function Badge({ tone, children }: { tone: Tone; children: ComponentChildren }) {
  return <span class={`badge ${tone}`}>{children}</span>;
}

/** A sentence of the process; what stands in backticks is code. */
export function Words({ text }: { text: string }) {
  const parts = text.split("`");
  return <>{parts.map((part, index) => (index % 2 ? <code key={index}>{part}</code> : part))}</>;
}

/** A link to another page, in another tab. What is no address of the web is no link: processes say it. */
export function Out({ href, children }: { href: string; children: ComponentChildren }) {
  if (!/^https?:\/\//i.test(href)) return <>{children}</>;
  return (
    <a class="out" href={href} target="_blank" rel="noopener noreferrer">
      {children} ↗
    </a>
  );
}

/** A time of day that says its date when it is read out or pointed at. */
export function Time({ ms, now }: { ms: number | null | undefined; now: number }) {
  if (ms === null || ms === undefined) return <span class="quiet">not known</span>;
  const iso = new Date(ms).toISOString();
  return (
    <time dateTime={iso} title={`${iso}, ${ago(ms, now)}`}>
      {clock(ms, now)}
    </time>
  );
}

/** What is said where a list has nothing: why, and what to do. */
export function Empty({ title, children }: { title: string; children?: ComponentChildren }) {
  return (
    <div class="empty">
      <p>
        <strong>{title}</strong>
      </p>
      {children}
    </div>
  );
}

/** The field that searches a view; the key `/` leads to it. */
export function Search(properties: { label: string; value: string; change: (text: string) => void; hint: string }) {
  return (
    <label class="search">
      <span class="hidden">{properties.label}</span>
      <input
        type="search"
        value={properties.value}
        placeholder={properties.label}
        title={properties.hint}
        autocomplete="off"
        spellcheck={false}
        data-search
        onInput={(event) => properties.change(event.currentTarget.value)}
      />
    </label>
  );
}

/** Choices of which one holds. */
export function Choice<T extends string>(properties: {
  label: string;
  value: T;
  choices: readonly (readonly [T, string])[];
  change: (value: T) => void;
}) {
  return (
    <div class="choice" role="group" aria-label={properties.label}>
      {properties.choices.map(([value, words]) => (
        <button
          key={value}
          type="button"
          aria-pressed={value === properties.value}
          onClick={() => properties.change(value)}
        >
          {words}
        </button>
      ))}
    </div>
  );
}

const PAGE = 100;

/** A table of at most 100 rows, and as many more as are asked for: what is not looked at costs nothing. */
export function Rows<T>(properties: {
  label: string;
  heads: readonly string[];
  items: readonly T[];
  row: (item: T) => ComponentChildren;
}) {
  const [shown, show] = useState(PAGE);
  const { items, heads } = properties;
  return (
    <>
      <div class="table" role="region" aria-label={properties.label} tabIndex={0}>
        <table>
          <caption class="hidden">{properties.label}</caption>
          <thead>
            <tr>
              {heads.map((head) => (
                <th key={head} scope="col">
                  {head}
                </th>
              ))}
            </tr>
          </thead>
          <tbody>{items.slice(0, shown).map(properties.row)}</tbody>
        </table>
      </div>
      {items.length > shown && (
        <button type="button" class="more" onClick={() => show(shown + PAGE)}>
          {Math.min(PAGE, items.length - shown)} more of {count(items.length, "row")}
        </button>
      )}
    </>
  );
}

/** A cell with the name of its column, which telephones show beside it. */
export function Cell({ head, children, wide }: { head: string; children: ComponentChildren; wide?: boolean }) {
  return (
    <td data-head={head} class={wide ? "wide" : ""}>
      {children}
    </td>
  );
}

/** Says which sources of what a view shows are away, since when, and what to do: what is shown is as of then. */
export function Stale({ kinds, now }: { kinds: readonly Source["carries"][number][]; now: number }) {
  const sources = useItems("sources");
  const away = [...sources.values()].filter(
    (source) => !source.ok && source.carries.some((kind) => kinds.includes(kind)),
  );
  if (!away.length) return null;
  return (
    <div class="note bad" role="status">
      {away.map((source) => (
        <p key={source.name}>
          <strong>
            {source.name}: away since {clock(source.since_ms, now)}.
          </strong>{" "}
          <Words text={`${source.problem} ${source.advice}`} />
        </p>
      ))}
    </div>
  );
}
