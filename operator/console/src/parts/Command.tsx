import { useRef, useState } from "preact/hooks";

/** A command for a terminal, with a button that copies it; where a browser lets no page copy it selects it. */
export function Command({ text }: { text: string }) {
  const code = useRef<HTMLElement>(null);
  const [said, say] = useState("");
  const copy = (): void => {
    copied(text).then(
      () => say("copied"),
      () => {
        if (code.current) getSelection()?.selectAllChildren(code.current);
        say("selected: copy it by Ctrl+C");
      },
    );
  };
  return (
    <span class="command">
      <code ref={code}>{text}</code>{" "}
      <button type="button" onClick={copy} aria-label={`Copy ${text}`}>
        Copy
      </button>{" "}
      <span class="quiet" role="status">
        {said}
      </span>
    </span>
  );
}

/** Only pages by HTTPS, and of this machine, may copy: others have no clipboard. */
async function copied(text: string): Promise<void> {
  await navigator.clipboard.writeText(text);
}
