import { Component, type ComponentChildren } from "preact";

interface State {
  readonly problem: string | undefined;
}

/** Shows what stands in it; when that fails, says so in its place, and the rest of the page goes on. */
export class Guarded extends Component<{ name: string; children: ComponentChildren }, State> {
  override state: State = { problem: undefined };

  static override getDerivedStateFromError(error: unknown): State {
    return { problem: error instanceof Error ? error.message : String(error) };
  }

  override render() {
    if (this.state.problem === undefined) return this.props.children;
    return (
      <main id="main">
        <h1>{this.props.name} cannot be shown</h1>
        <div class="note bad" role="alert">
          The page stumbled over what it was told: <code>{this.state.problem}</code>. The other views go on. Load the
          page anew; if it stays so, page and process are of different versions, or this is a mistake to report.
        </div>
      </main>
    );
  }
}
