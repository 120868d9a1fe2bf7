import { useEffect, useState } from "preact/hooks";
import { readChain, Refused } from "../live/api";
import type { Chain, Kind, Step, WhyKind } from "../live/model";
import { Badge, Empty, Out, Stale, type Tone } from "../parts/parts";
import { live, useNow, usePlace, why } from "../state";
import { whenChanged } from "../live/changing";
import { clock, duration } from "../words";
import { argocdPage } from "../parts/links";
import { scaleOf, type Scale } from "./scale";

const KINDS_OF_CHAINS: readonly Kind[] = ["tasks", "plans", "releases", "pods", "events", "recordings"];
const PAUSE_MS = 1500;

/** The chain of cause and effect that one thing belongs to, on one time line. */
export function Why() {
  const [, kind, ...rest] = usePlace();
  const id = rest.join("/");
  const now = useNow();
  const answer = useChain(kind as WhyKind | undefined, id);
  if (!kind || !id)
    return (
      <main id="main">
        <h1>Why</h1>
        <Empty title="Choose an event, task, plan, release, pod, commit or recording in another view.">
          <p>Each of them leads here, to what it came of and what it led to.</p>
        </Empty>
      </main>
    );
  return (
    <main id="main" class="why">
      <h1>{answer.chain?.title || id}</h1>
      <p class="quiet">
        Why {kind} <code>{id}</code>
        {answer.chain && <>, as of {clock(answer.chain.time_ms, now)}</>}
      </p>
      <Stale kinds={KINDS_OF_CHAINS} now={now} />
      {answer.refused && <NoChain refused={answer.refused} />}
      {answer.chain && <TimeLine chain={answer.chain} now={now} />}
      {!answer.chain && !answer.refused && <p role="status">Looking for its chain …</p>}
    </main>
  );
}

function NoChain({ refused }: { refused: Refused }) {
  if (refused.status !== 404)
    return (
      <div class="note bad" role="alert">
        <strong>{refused.title}.</strong> {refused.message}
      </div>
    );
  return (
    <Empty title={refused.message}>
      <p>
        Managers remember their last 1000 plans. What is older is in the deployment repository:{" "}
        <code>robotkube audit</code> reads it from there.
      </p>
    </Empty>
  );
}

interface Answer {
  readonly chain?: Chain;
  readonly refused?: Refused;
}

/** The chain, read again when something of its kinds changed or nobody answered, at most every 1.5 s. */
function useChain(kind: WhyKind | undefined, id: string): Answer {
  const [answer, set] = useState<Answer & { key?: string }>({});
  const key = `${kind}/${id}`;
  useEffect(() => {
    if (!kind || !id) return undefined;
    const cut = new AbortController();
    const ask = async (): Promise<boolean> => {
      try {
        const chain = await readChain(kind, id, cut.signal);
        if (!cut.signal.aborted) set({ key, chain });
        return true;
      } catch (error) {
        const refused = error instanceof Refused ? error : new Refused(0, "No answer", String(error), undefined);
        if (!cut.signal.aborted) set((before) => ({ key, refused, ...keptChain(before, key) }));
        return refused.status === 404;
      }
    };
    void whenChanged(
      () => KINDS_OF_CHAINS.map((each) => live.table.changed.get(each)).join(),
      ask,
      PAUSE_MS,
      cut.signal,
    );
    return () => cut.abort();
  }, [key]);
  return answer.key === key ? answer : {};
}

/** What was read before stays, as of when it was, when it cannot be read again. */
function keptChain(before: Answer & { key?: string }, key: string): Answer {
  return before.key === key && before.chain ? { chain: before.chain } : {};
}

const TONES: Record<Step["state"], Tone> = { done: "good", waiting: "busy", failed: "bad", gone: "quiet" };

function TimeLine({ chain, now }: { chain: Chain; now: number }) {
  const timed = chain.steps.filter((step) => step.time_ms !== null);
  const end = (step: Step): number =>
    step.end_ms ?? (step.state === "waiting" ? Math.max(now, step.time_ms ?? now) : (step.time_ms ?? now));
  const scale = scaleOf(timed.map((step) => ({ from: step.time_ms as number, to: end(step) })));
  const first = timed.length ? Math.min(...timed.map((step) => step.time_ms as number)) : undefined;
  return (
    <>
      {first !== undefined && <Summary chain={chain} first={first} now={now} scale={scale} />}
      <ol class="chain">
        {chain.steps.map((step, index) => (
          <StepLine
            key={`${step.step} ${step.id} ${index}`}
            step={step}
            first={first}
            own={step.kind === chain.kind && step.id === chain.id}
            scale={scale}
            until={step.time_ms === null ? null : end(step)}
            now={now}
          />
        ))}
      </ol>
    </>
  );
}

function Summary({ chain, first, now, scale }: { chain: Chain; first: number; now: number; scale: Scale }) {
  const waiting = chain.steps.find((step) => step.state === "waiting");
  const failed = chain.steps.find((step) => step.state === "failed");
  const pods = chain.steps.filter((step) => step.step === "pod").flatMap((step) => step.end_ms ?? []);
  return (
    <p class="summary">
      Began {clock(first, now)}.{" "}
      {pods.length > 0 && <>What it asked for ran after {duration((Math.min(...pods) - first) / 1000)}. </>}
      {failed && (
        <span class="bad">
          It failed at {failed.step}: {failed.text}.{" "}
        </span>
      )}
      {waiting && !failed && (
        <>
          It waits for {waiting.step}: {waiting.text}.{" "}
        </>
      )}
      {scale.cuts.map((cut) => (
        <span key={cut.at} class="quiet">
          A pause of {duration(cut.milliseconds / 1000)} is drawn as a gap.{" "}
        </span>
      ))}
    </p>
  );
}

interface LineProperties {
  readonly step: Step;
  readonly first: number | undefined;
  readonly own: boolean;
  readonly scale: Scale;
  readonly until: number | null;
  readonly now: number;
}

function StepLine({ step, first, own, scale, until, now }: LineProperties) {
  const title = step.title || step.id;
  const link = step.link || (step.step === "Application" ? argocdPage(live.table.links.argocd, title) : "");
  return (
    <li class={own ? "own" : ""} aria-current={own ? "step" : undefined}>
      <div class="when">
        {step.time_ms === null ? (
          <span class="quiet">time not known</span>
        ) : (
          <>
            <strong>+{duration((step.time_ms - (first ?? step.time_ms)) / 1000)}</strong>
            <span class="quiet">{clock(step.time_ms, now)}</span>
          </>
        )}
      </div>
      <div class="what">
        <div>
          <span class="step">{step.step}</span>{" "}
          {step.kind && !own ? (
            <a href={why(step.kind as WhyKind, step.id)}>{title}</a>
          ) : (
            <span class="name">{title}</span>
          )}{" "}
          {step.state !== "done" && <Badge tone={TONES[step.state]}>{step.state}</Badge>}
          {link && (
            <Out href={link}>
              open<span class="hidden"> {title} in another tab</span>
            </Out>
          )}
        </div>
        <div class={step.state === "failed" ? "bad" : "quiet"}>
          {step.text}
          {step.end_ms !== null && step.time_ms !== null && (
            <>
              {step.text && ", "}took {duration((step.end_ms - step.time_ms) / 1000)}
            </>
          )}
        </div>
        <Bar step={step} scale={scale} until={until} />
        <Details step={step} />
      </div>
    </li>
  );
}

const WIDTH = 1000;

/** Where the step lies on the chain's time line. The figures beside it say the same. */
function Bar({ step, scale, until }: { step: Step; scale: Scale; until: number | null }) {
  if (step.time_ms === null || until === null) return null;
  const from = scale.position(step.time_ms) * WIDTH;
  const to = scale.position(until) * WIDTH;
  const width = Math.max(4, to - from);
  return (
    <svg class={`bar ${step.state}`} viewBox={`0 0 ${WIDTH} 10`} preserveAspectRatio="none" aria-hidden="true">
      <rect class="way" x="0" y="4" width={WIDTH} height="2" />
      {scale.cuts.map((cut) => (
        <rect key={cut.at} class="cut" x={cut.at * WIDTH - 6} y="3" width="12" height="4" />
      ))}
      <rect class="stretch" x={Math.min(from, WIDTH - width)} y="0" width={width} height="10" rx="2" />
    </svg>
  );
}

function Details({ step }: { step: Step }) {
  if (!step.details.length) return null;
  return (
    <details>
      <summary>
        {step.details.length === 1 ? "1 detail" : `${step.details.length} details`}
        <span class="hidden"> of {step.title || step.id}</span>
      </summary>
      <dl>
        {step.details.map(({ label, value }, index) => (
          <div key={index}>
            <dt>{label}</dt>
            <dd>{value}</dd>
          </div>
        ))}
      </dl>
    </details>
  );
}
