/**
 * What was typed into a search field: words, all of which must be found. A word `key:value` looks only at that key of
 * what is searched, any other at everything.
 */
export type Searched = Readonly<Record<string, string | readonly string[] | undefined>>;

interface Term {
  readonly key: string | undefined;
  readonly value: string;
}

/** A filter by the text of a search field. */
export function filter(text: string): (searched: Searched) => boolean {
  const terms = text.toLowerCase().split(/\s+/).filter(Boolean).map(term);
  return (searched) => terms.every((each) => matches(each, searched));
}

function term(word: string): Term {
  const colon = word.indexOf(":");
  return colon > 0 ? { key: word.slice(0, colon), value: word.slice(colon + 1) } : { key: undefined, value: word };
}

function matches({ key, value }: Term, searched: Searched): boolean {
  if (key !== undefined && key in searched) return found(value, searched[key]);
  const whole = key === undefined ? value : `${key}:${value}`;
  return Object.values(searched).some((field) => found(whole, field));
}

function found(value: string, field: string | readonly string[] | undefined): boolean {
  if (field === undefined) return false;
  return typeof field === "string"
    ? field.toLowerCase().includes(value)
    : field.some((each) => each.toLowerCase().includes(value));
}
