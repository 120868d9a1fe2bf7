"""Policy for Nodes: whose machine each is.

Labels say it, and Kubernetes lets a kubelet write those of its own Node. With the certificate of one machine somebody
would have the pods of every other come to it, the gate and its key among them.
"""

from __future__ import annotations

from robotkube.registry.admission.core.documents import Policy, Validation
from robotkube.registry.admission.core.expressions import CREATING, WRITER, sentence

KUBELETS = "system:node:"
OURS = "robotkube.io/"
NOW, BEFORE = (f"{whole}.metadata.?labels.orValue({{}})" for whole in ("object", "oldObject"))


def policy() -> Policy:
    """A kubelet changes none of the platform's labels of a Node that is there. One that registers brings its own: who
    let it join has said so. Status is judged as well, since labels come that way too."""
    others = f"!k.startsWith('{OURS}')"
    came = f"{NOW}.all(k, {others} || k in {BEFORE} && {BEFORE}[k] == {NOW}[k])"
    went = f"{BEFORE}.all(k, {others} || k in {NOW})"
    holds = f"!{WRITER}.startsWith('{KUBELETS}') || {CREATING} || {came} && {went}"
    why = f": whose machine it is, and what for ({OURS}), is not its own to say. Have an administrator label it"
    says = sentence("labels of Node ", "object.metadata.name", " changed by ", WRITER, why)
    return Policy("robotkube-nodes", [("", ["nodes", "nodes/status"])], None, [], [Validation(holds, says)])
