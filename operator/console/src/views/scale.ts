/** A stretch of time, in milliseconds. */
export interface Stretch {
  readonly from: number;
  readonly to: number;
}

/** A pause in which nothing happened, drawn shorter than it was; `at` is its middle as a part of the width. */
export interface Cut {
  readonly at: number;
  readonly milliseconds: number;
}

export interface Scale {
  /** Where a time lies, as a part of the width from 0 to 1. */
  readonly position: (time: number) => number;
  readonly cuts: readonly Cut[];
}

const SHARE_MAX = 0.4;
const CUT_SHARE = 0.08;

/**
 * A scale on which stretches keep their proportions, while pauses that are longer than 40 % of all that happened are
 * cut to 8 %: an encounter of two minutes would hide what took two seconds.
 */
export function scaleOf(stretches: readonly Stretch[]): Scale {
  const busy = merged(stretches);
  const pauses = busy.slice(1).map((each, index) => ({ from: (busy[index] as Stretch).to, to: each.from }));
  const length = ({ from, to }: Stretch): number => to - from;
  const happened = sum(busy.map(length));
  const long = cutPauses(pauses, happened);
  const kept = happened + sum(pauses.filter((pause) => !long.has(pause)).map(length));
  const short = Math.max(kept, 1) * CUT_SHARE;
  const width = Math.max(1, kept + long.size * short);
  const pieces = interleaved(busy, pauses).map((piece) => ({
    ...piece,
    width: long.has(piece) ? short : length(piece),
  }));
  const position = (time: number): number => {
    let before = 0;
    for (const piece of pieces) {
      if (time <= piece.to) return (before + part(piece, time) * piece.width) / width;
      before += piece.width;
    }
    return Math.min(1, before / width);
  };
  const cuts = [...long].map((pause) => ({
    at: (position(pause.from) + position(pause.to)) / 2,
    milliseconds: length(pause),
  }));
  return { position, cuts };
}

/** Pauses that are cut: the longest ones, as long as they are too long beside all that is left. */
function cutPauses(pauses: readonly Stretch[], happened: number): Set<Stretch> {
  const shortest = [...pauses].sort((one, other) => one.to - one.from - (other.to - other.from));
  let kept = happened;
  const cut = new Set<Stretch>();
  for (const pause of shortest) {
    const milliseconds = pause.to - pause.from;
    if (milliseconds > SHARE_MAX * (kept + milliseconds) && kept > 0) cut.add(pause);
    else kept += milliseconds;
  }
  return cut;
}

function merged(stretches: readonly Stretch[]): Stretch[] {
  const result: Stretch[] = [];
  for (const each of [...stretches].sort((one, other) => one.from - other.from)) {
    const last = result.at(-1);
    if (last && each.from <= last.to) result[result.length - 1] = { from: last.from, to: Math.max(last.to, each.to) };
    else result.push(each);
  }
  return result;
}

function interleaved(busy: readonly Stretch[], pauses: readonly Stretch[]): Stretch[] {
  return busy.flatMap((each, index) => [each, ...(pauses[index] ? [pauses[index]] : [])]);
}

function part({ from, to }: Stretch, time: number): number {
  return to > from ? Math.max(0, (time - from) / (to - from)) : 0;
}

const sum = (numbers: readonly number[]): number => numbers.reduce((total, each) => total + each, 0);
