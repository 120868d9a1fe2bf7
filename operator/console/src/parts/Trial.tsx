import { useItems } from "../state";
import { trialWords } from "./sharing";

/** Says that agents share Nodes, and what that means, while any do. */
export function Trial() {
  const words = trialWords(useItems("agents").values());
  return words ? (
    <p class="note warn" role="status">
      {words}
    </p>
  ) : null;
}
