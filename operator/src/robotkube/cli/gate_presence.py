"""What `robotkube status` says of the gate itself: whether it is there, since when it is not, and what to do then."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.cli.output import Table

GATE = "gate"  # the name of its Deployment
COLUMNS = ("process", "namespace", "since", "problem")
AVAILABLE = "Available"
MEANWHILE = (
    "nothing is merged, published or signed; tasks and pull requests wait, what runs goes on. Repair it first; for "
    "what cannot wait: docs/how-to/break-the-glass.md"
)

Object = Mapping[str, Any]


@dataclass(frozen=True)
class GatePresence:
    """The gate as its Deployment says. `problem` is empty when it is there; `since` when that is known; `unknown` when
    whoever asks may not read it."""

    namespace: str = ""
    problem: str = ""
    since: str = ""
    unknown: str = ""

    @property
    def table(self) -> Table:
        """One row when it is away, none when it is there or not known."""
        row = {"process": GATE, "namespace": self.namespace, "since": self.since, "problem": self.problem}
        return Table("away", COLUMNS, [row] if self.problem else [])

    @property
    def words(self) -> str:
        """A sentence that the gate is away, and what that means; empty when it is there."""
        if not self.problem:
            return ""
        since = f" since {self.since}" if self.since else ""
        return f"the gate is away{since}: {self.problem}. Until it is back {MEANWHILE}"

    @property
    def text(self) -> str:
        """A line for people when it is not known; empty otherwise."""
        return f"whether the gate is there is not known: {self.unknown}\n" if self.unknown else ""


def presence(namespace: str, deployment: Object) -> GatePresence:
    """Return whether the gate is there, by its Deployment; empty when there is none."""
    if not deployment:
        return GatePresence(
            namespace,
            f"there is no Deployment {GATE} in namespace {namespace}: upgrade the release of charts/robotkube, which "
            "has it (see --platform-namespace)",
        )
    if deployment["spec"].get("replicas") == 0:
        return GatePresence(
            namespace,
            f"it is scaled to 0: kubectl -n {namespace} scale deployment {GATE} --replicas=1",
        )
    status = deployment.get("status") or {}
    if int(status.get("availableReplicas") or 0):
        return GatePresence(namespace)
    conditions = {entry["type"]: entry for entry in status.get("conditions") or ()}
    return GatePresence(
        namespace,
        f"its pod is not there, or not ready, which it is while it sees the forge: kubectl -n {namespace} describe "
        f"pods, and logs deployment/{GATE}, say why",
        str(conditions.get(AVAILABLE, {}).get("lastTransitionTime") or ""),
    )
