"""A cluster in memory: ports TaskStore, Cluster and ArgoCD; and an Argo CD whose progress a test decides."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from robotkube.delivery.deployment.core.releases import Release, application_name
from robotkube.delivery.manager.core.observation import ApplicationState, PodState
from robotkube.delivery.manager.core.placement.placement import NodeState
from robotkube.delivery.manager.core.updates.probe_answers import ProbeLoss
from robotkube.delivery.manager.core.updates.rule_events import RuleEvent


@dataclass
class MemoryTasks:
    """TaskDescriptions by key; `namespaces`: those that are seen (none: all)."""

    objects: dict[str, dict[str, Any]] = field(default_factory=dict)
    patches: int = 0
    created: int = 0
    reports: list[tuple[str, str, str]] = field(default_factory=list)
    namespaces: frozenset[str] = frozenset()

    def tasks(self) -> Sequence[Mapping[str, Any]]:
        """The objects as they are; others may come and go on another thread meanwhile."""
        return [
            copy.deepcopy(task)
            for task in list(self.objects.values())
            if not self.namespaces or task["metadata"]["namespace"] in self.namespaces
        ]

    def patch_status(self, namespace: str, name: str, status: Mapping[str, Any]) -> bool:
        """Merge into the status, as a merge patch does; False when the task is gone."""
        task = self.objects.get(f"{namespace}/{name}")
        if task is None:
            return False
        self.patches += 1
        merged = {**task.get("status", {}), **copy.deepcopy(dict(status))}
        task["status"] = {key: value for key, value in merged.items() if value is not None}
        return True

    def withdraw(self, namespace: str, name: str) -> bool:
        """Delete a task at once; False when there is none."""
        return self.objects.pop(f"{namespace}/{name}", None) is not None

    def report_on_task(self, task: Mapping[str, Any], reason: str, text: str) -> None:
        """Remember task, reason and text, once."""
        report = (f"{task['metadata']['namespace']}/{task['metadata']['name']}", reason, text)
        if report not in self.reports:
            self.reports.append(report)

    def create(self, namespace: str, name: str, spec: Mapping[str, Any], created: str = "2026-11-21T10:00:00Z") -> None:
        """Create a task."""
        self.created += 1
        metadata = {"namespace": namespace, "name": name, "generation": 1, "creationTimestamp": created}
        metadata |= {"uid": f"uid-{self.created}", "annotations": {}}
        self.objects[f"{namespace}/{name}"] = {"metadata": metadata, "spec": copy.deepcopy(dict(spec))}

    def change(self, key: str, **spec: Any) -> None:
        """Change values of the spec, which makes a new generation."""
        task = self.objects[key]
        task["spec"] = {**task["spec"], **copy.deepcopy(spec)}
        task["metadata"]["generation"] += 1

    def annotate(self, key: str, name: str, text: str) -> None:
        """Set an annotation, which is no new generation."""
        self.objects[key]["metadata"]["annotations"][name] = text

    def delete(self, key: str) -> None:
        """Delete a task."""
        del self.objects[key]

    def condition(self, key: str, kind: str) -> tuple[str, str]:
        """Status and reason of a condition; two empty texts when it is not there."""
        for condition in self.objects[key].get("status", {}).get("conditions", []):
            if condition["type"] == kind:
                return condition["status"], condition["reason"]
        return "", ""


@dataclass
class MemoryCluster:
    """Nodes, Argo CD Applications and pods."""

    machines: list[NodeState] = field(default_factory=list)
    states: dict[str, ApplicationState] = field(default_factory=dict)
    running: dict[str, list[PodState]] = field(default_factory=dict)
    reports: list[tuple[str, str, str]] = field(default_factory=list)
    events: list[RuleEvent] = field(default_factory=list)
    losses: list[ProbeLoss] = field(default_factory=list)

    def rule_events(self) -> Sequence[RuleEvent]:
        """The events of rules."""
        return list(self.events)

    def probe_losses(self) -> Sequence[ProbeLoss]:
        """The losses of readiness."""
        return list(self.losses)

    def report_on_node(self, node: str, reason: str, text: str) -> None:
        """Remember node, reason and text, once."""
        if (node, reason, text) not in self.reports:
            self.reports.append((node, reason, text))

    def nodes(self) -> Sequence[NodeState]:
        """The nodes of agents."""
        return list(self.machines)

    def applications(self) -> Mapping[str, ApplicationState]:
        """Argo CD Applications by name."""
        return dict(self.states)

    def pods(self, release: str) -> Sequence[PodState]:
        """Pods of a release."""
        return self.running.get(release, [])

    def show(self, release: Release) -> None:
        """Show a release as Argo CD does when it has done everything for it."""
        name = application_name(release.namespace, release.name)
        source = {"digest": release.digest, "plan": release.plan}
        self.states[name] = ApplicationState(
            name, release.plan, source, source, source, phase="Succeeded", sync="Synced", health="Healthy"
        )
        self.running[release.key] = [PodState(release.namespace, f"{release.name}-0", release.key)]

    def settle(self, releases: Mapping[str, Release]) -> None:
        """Show exactly these `releases` (by path), as Argo CD does when it has done everything."""
        wanted = {application_name(r.namespace, r.name): r for r in releases.values()}
        keys = {release.key for release in wanted.values()}
        self.states = {name: state for name, state in self.states.items() if name in wanted}
        self.running = {key: pods for key, pods in self.running.items() if key in keys}
        for release in wanted.values():
            self.show(release)

    def worsen(self, name: str, health: str) -> None:
        """Set the health that an Application has lost."""
        self.states[name] = replace(self.states[name], health=health)


@dataclass
class MemoryArgoCD:
    """An Argo CD that notes the calls it gets."""

    hooks: list[tuple[str, str]] = field(default_factory=list)
    refreshes: list[str] = field(default_factory=list)

    def hook(self, before: str, after: str) -> bool:
        """Note a push hook."""
        self.hooks.append((before, after))
        return True

    def refresh(self, application: str) -> bool:
        """Note a refresh."""
        self.refreshes.append(application)
        return True
