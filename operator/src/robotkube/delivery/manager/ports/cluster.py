"""The cluster as the manager reads it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from robotkube.delivery.manager.core.observation import ApplicationState, PodState
from robotkube.delivery.manager.core.placement.placement import NodeState
from robotkube.delivery.manager.core.updates.probe_answers import ProbeLoss
from robotkube.delivery.manager.core.updates.rule_events import RuleEvent


class Cluster(Protocol):
    """The cluster; its values are snapshots kept up to date by watches."""

    def nodes(self) -> Sequence[NodeState]:
        """Nodes of agents."""
        ...

    def applications(self) -> Mapping[str, ApplicationState]:
        """Argo CD Applications by name."""
        ...

    def pods(self, release: str) -> Sequence[PodState]:
        """Pods of a release, named `<namespace>/<release>` (label app.kubernetes.io/instance)."""
        ...

    def rule_events(self) -> Sequence[RuleEvent]:
        """The events of rules that tasks brought lately, also tasks that are gone."""
        ...

    def probe_losses(self) -> Sequence[ProbeLoss]:
        """The times at which readiness probes said no lately, after they had said yes."""
        ...

    def report_on_node(self, node: str, reason: str, text: str) -> None:
        """Write a warning about a Node (a Kubernetes Event in the platform's namespace); the same text once."""
        ...
