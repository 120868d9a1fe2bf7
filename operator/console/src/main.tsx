import { render } from "preact";
import { App } from "./app";
import { live } from "./state";

render(<App />, document.getElementById("page") as HTMLElement);
void live.run();
