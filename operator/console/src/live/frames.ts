/** One thing that a stream of server-sent events says: an event, or a comment, which shows that the way is open. */
export type Frame =
  | { readonly kind: "comment" }
  | { readonly kind: "event"; readonly id: string | undefined; readonly event: string; readonly data: string };

const LINE = /\r\n|\n|\r/;

/**
 * Reads server-sent events (HTML standard, 9.2) from text that arrives in pieces. Browsers' own EventSource hides
 * comments and the status of the answer, both of which the page needs.
 */
export class FrameReader {
  private rest = "";
  private data: string[] = [];
  private event = "";
  private id: string | undefined;

  /** The frames that are whole with this piece of text. */
  read(piece: string): Frame[] {
    const text = this.rest + piece;
    // A carriage return at the end may be half of a line's end.
    const held = text.endsWith("\r") ? "\r" : "";
    const lines = text.slice(0, text.length - held.length).split(LINE);
    this.rest = (lines.pop() ?? "") + held;
    return lines.flatMap((line) => this.line(line));
  }

  private line(line: string): Frame[] {
    if (line === "") return this.finish();
    if (line.startsWith(":")) return [{ kind: "comment" }];
    const [, name, value] = /^([^:]*)(?:: ?(.*))?$/s.exec(line) ?? [];
    if (name === "data") this.data.push(value ?? "");
    else if (name === "event") this.event = value ?? "";
    else if (name === "id") this.id = value ?? "";
    return [];
  }

  private finish(): Frame[] {
    const frame: Frame = {
      kind: "event",
      id: this.id,
      event: this.event || "message",
      data: this.data.join("\n"),
    };
    const said = this.data.length > 0;
    this.data = [];
    this.event = "";
    return said ? [frame] : [];
  }
}
