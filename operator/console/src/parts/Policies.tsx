import { live, useItems } from "../state";
import { policiesPage } from "./links";
import { Out } from "./parts";

/** Where policies are changed: in Git, by a pull request that the gate checks; never here. */
export function Policies() {
  const plans = useItems("plans").values();
  const page = policiesPage(
    Array.from(plans, (plan) => plan.url),
    live.table.links.forge,
  );
  return (
    <p class="quiet">
      What may run where, and what is approved by people, is changed in Git:{" "}
      {page ? <Out href={page}>policies</Out> : <code>policies/</code>} of the deployment repository.
    </p>
  );
}
