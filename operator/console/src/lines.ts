/** The difference of two texts, line by line. */

export interface Line {
  readonly mark: " " | "-" | "+";
  readonly text: string;
}

const LINES_MAX = 600;
const CONTEXT = 2;

/** The lines that went, came, or stand near those; null where a text is not there. */
export function difference(before: string | null, after: string | null): readonly Line[] {
  const [one, other] = [linesOf(before), linesOf(after)];
  const lines = one.length * other.length > LINES_MAX * LINES_MAX ? replaced(one, other) : compared(one, other);
  return near(lines);
}

const linesOf = (text: string | null): readonly string[] => (text ? text.replace(/\n$/, "").split("\n") : []);

function replaced(one: readonly string[], other: readonly string[]): Line[] {
  return [...one.map((text) => ({ mark: "-", text }) as Line), ...other.map((text) => ({ mark: "+", text }) as Line)];
}

/** By the longest common subsequence; `common[i][j]` is its length of the lines from i and from j on. */
function compared(one: readonly string[], other: readonly string[]): Line[] {
  const common = Array.from({ length: one.length + 1 }, () => new Uint16Array(other.length + 1));
  const at = (i: number, j: number): number => common[i]?.[j] ?? 0;
  for (let i = one.length - 1; i >= 0; i -= 1)
    for (let j = other.length - 1; j >= 0; j -= 1)
      (common[i] as Uint16Array)[j] = one[i] === other[j] ? at(i + 1, j + 1) + 1 : Math.max(at(i + 1, j), at(i, j + 1));
  const lines: Line[] = [];
  let [i, j] = [0, 0];
  while (i < one.length || j < other.length) {
    const same = i < one.length && j < other.length && one[i] === other[j];
    const goes = !same && i < one.length && (j === other.length || at(i + 1, j) >= at(i, j + 1));
    lines.push({ mark: same ? " " : goes ? "-" : "+", text: (same || goes ? one[i] : other[j]) ?? "" });
    if (same || goes) i += 1;
    if (same || !goes) j += 1;
  }
  return lines;
}

function near(lines: readonly Line[]): readonly Line[] {
  const changed = (index: number): boolean => (lines[index]?.mark ?? " ") !== " ";
  const offsets = Array.from({ length: 2 * CONTEXT + 1 }, (_, index) => index - CONTEXT);
  return lines.filter((_, index) => offsets.some((offset) => changed(index + offset)));
}
