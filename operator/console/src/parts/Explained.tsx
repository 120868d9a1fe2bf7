import type { Explanation } from "../live/model";
import { difference } from "../lines";
import { Badge, Words, type Tone } from "./parts";

const TONES: Record<Explanation["outcome"], Tone> = {
  Accepted: "good",
  Postponed: "warn",
  Refused: "bad",
  Withdrawn: "quiet",
};
const WORDS: Record<Explanation["outcome"], string> = {
  Accepted: "would be accepted",
  Postponed: "would be postponed",
  Refused: "would be refused",
  Withdrawn: "would be withdrawn",
};

/** What a manager says that would become of a task: the outcome, every choice in words, and the files that change. */
export function Explained({ answer }: { answer: Explanation }) {
  const [, ...choices] = answer.lines;
  return (
    <section class="card explained" aria-labelledby="explained-head">
      <h2 id="explained-head">
        What would happen <Badge tone={TONES[answer.outcome]}>{WORDS[answer.outcome]}</Badge>
      </h2>
      {answer.message && (
        <p class={answer.outcome === "Refused" ? "bad" : ""}>
          {answer.reason}: <Words text={answer.message} />
        </p>
      )}
      {answer.waits && <p>It would wait: {answer.waits}</p>}
      <ul>
        {choices.map((line, index) => (
          <li key={index}>{line}</li>
        ))}
      </ul>
      {answer.changes.map((change) => (
        <FileChange key={change.path} {...change} />
      ))}
    </section>
  );
}

const HOW = { "+": "comes", "-": "goes", " ": "stays" };

function FileChange({ path, before, after }: Explanation["changes"][number]) {
  const word = before === null ? "new" : after === null ? "removed" : "changed";
  return (
    <details>
      <summary>
        <code>{path}</code> {word}
      </summary>
      <pre class="difference" tabIndex={0} role="region" aria-label={`Difference of ${path}`}>
        {difference(before, after).map(({ mark, text }, index) => (
          <div key={index} class={HOW[mark]}>
            {mark} {text}
          </div>
        ))}
      </pre>
    </details>
  );
}
