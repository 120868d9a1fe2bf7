"""Readiness, the state a run begins from: everything that the deployment repository asks for runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from scenarios.definition import Scenario
from scenarios.runner.observing import collecting
from scenarios.runner.platform.access import Access, pod_ready
from scenarios.runner.platform.deployment import Deployment

PLAN = "robotkube.io/plan"


class Readiness:
    """Checks of repository, manager, Argo CD and pods; `missing` names in few words what is not there yet."""

    def __init__(self, access: Access, deployment: Deployment, scenario: Scenario) -> None:
        self._access, self._deployment, self._scenario = access, deployment, scenario
        self._missing: Sequence[str] = ("nothing was checked yet",)

    def reached(self) -> bool:
        """Checks once, the dearest things last and only when the others are as they should be."""
        self._deployment.fetch()
        releases = self._deployment.releases()
        checks: Sequence[Callable[[], Sequence[str]]] = (
            lambda: [f"release {name} is not in the repository" for name in self._needed() if name not in releases],
            lambda: self._with_another_rule(releases),
            self._plans,
            lambda: not_observed(releases, self._access.applications()),
            self._pods,
        )
        self._missing = next((missing for missing in (check() for check in checks) if missing), ())
        return not self._missing

    def missing(self) -> str:
        """One line: how many things are missing, and the first."""
        return f"{len(self._missing)} missing: {'; '.join(self._missing[:3])}"

    def _needed(self) -> Sequence[str]:
        """Releases that the run cannot do without."""
        story = self._scenario.story
        needed = list(story.ready)
        if story.player_application:
            releases = (story.player_application, "mqtt-bridge")
            needed += [f"{agent}/{release}" for agent in self._scenario.vehicles for release in releases]
        if self._scenario.records:
            needed += [f"{story.recording_agent}/mqtt-bridge", f"{story.recording_agent}/{collecting.DETECTOR}"]
        return needed

    def _with_another_rule(self, releases: Mapping[str, Any]) -> Sequence[str]:
        """The operator's release when it has another rule than the scenario's: after an earlier run it is there, and
        the plan that changes it may be still to come."""
        if not self._scenario.records:
            return ()
        parameters = self._scenario.parameters
        detector = f"{self._scenario.story.recording_agent}/{collecting.DETECTOR}"
        wanted = (list(self._scenario.lidar_vehicles), parameters.start_distance_m, parameters.stop_distance_m)
        rules = releases[detector]["spec"]["values"]["detector"]["rules"]
        present = [tuple(rule.get(key) for key in ("agents", "start_distance_m", "stop_distance_m")) for rule in rules]
        return () if wanted in present else (f"release {detector} has another rule than the scenario's",)

    def _plans(self) -> Sequence[str]:
        """Those that the manager waits for. When it began after they were on main, it does not know when they were
        observed; whether they are, the releases say."""
        plans = collecting.plans(self._access, collecting.Collecting(lambda _: None))
        waited_for = (plan for plan in plans if plan.started is not None and plan.observed is None)
        return [f"plan {plan.plan} is not observed" for plan in waited_for if plan.error is None]

    def _pods(self) -> Sequence[str]:
        return [
            f"pod {pod.metadata.namespace}/{pod.metadata.name} is not ready"
            for pod in self._access.pods_of_agents()
            if not pod_ready(pod)
        ]


def not_observed(releases: Mapping[str, Any], applications: Mapping[str, Any]) -> Sequence[str]:
    """Releases whose Argo CD Application does not run the plan that the repository states, synced and healthy."""
    problems = []
    for name, release in sorted(releases.items()):
        application = applications.get(name.replace("/", "-"))
        wanted = release["metadata"]["annotations"][PLAN]
        problem = _problem(application, wanted)
        if problem:
            problems.append(f"{name}: {problem}")
    return problems


def _problem(application: Any, plan: str) -> str:
    if application is None:
        return "Argo CD has no Application for it yet"
    if application["metadata"].get("annotations", {}).get(PLAN) != plan:
        return f"Argo CD does not know plan {plan} yet"
    status = application.get("status", {})
    synced, healthy = status.get("sync", {}).get("status"), status.get("health", {}).get("status")
    if (synced, healthy) != ("Synced", "Healthy"):
        return f"{synced or 'not compared'}, {healthy or 'health not known'}"
    return ""
