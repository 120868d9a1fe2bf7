import { render } from "preact";
import { App } from "./app";
import { live } from "./state";
import { Guarded } from "./parts/Guarded";

const page = (
  <Guarded name="The page">
    <App />
  </Guarded>
);
render(page, document.getElementById("page") as HTMLElement);
void live.run();
