"""Outcomes of a story's demands: judged by main and by the conditions that the tasks showed, not by what the manager
reports of itself.

Pure; None means that the inputs do not contain it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

from scenarios.definition import Scenario
from scenarios.runner.inputs import NANOSECONDS, RunInputs, TaskCondition, TaskLife

BRIDGE = "mqtt-bridge"  # shared by all demands: it belongs to no single one
OFFLOAD_ROLES = ("cloud",)
PARENTS_MAX = 16
AFTER_REMOVAL_SECONDS = 2
TRACKER = "object-tracking"


def steps_reached(inputs: RunInputs) -> float | None:
    """The share of the story's steps whose outcome was seen within its bound."""
    return sum(step.done is not None for step in inputs.steps) / len(inputs.steps) if inputs.steps else None


def offloaded(scenario: Scenario, inputs: RunInputs) -> tuple[TaskLife, ...]:
    """Tasks with policy Offload that ran on the roles they may be offloaded to, and never where they had asked for."""
    roles = {node.agent: node.role for node in scenario.nodes}
    return tuple(
        task
        for task in inputs.tasks
        if task.spec.get("conflictPolicy") == "Offload"
        and (there := {roles.get(agent, "") for agent in _agents(inputs, task)})
        and there <= set(task.spec.get("offloadTo", OFFLOAD_ROLES))
    )


def postponed(inputs: RunInputs) -> tuple[TaskLife, ...]:
    """Tasks whose condition was Postponed, that had no release then and ran afterwards."""
    return tuple(task for task in inputs.tasks if _had_reason(task, "Postponed") and any(_releases(inputs, task)))


def refused(inputs: RunInputs) -> tuple[TaskLife, ...]:
    """Tasks refused for want of resources that never had a release."""
    return tuple(
        task for task in inputs.tasks if _had_reason(task, "InsufficientResources") and not any(_releases(inputs, task))
    )


def preempted(inputs: RunInputs) -> tuple[TaskLife, ...]:
    """Tasks that ran, whose condition became Preempted, and that had no release any more although they were there."""
    return tuple(task for task in inputs.tasks if _had_reason(task, "Preempted") and _lost_its_releases(inputs, task))


def reasons_named(scenario: Scenario, inputs: RunInputs) -> float | None:
    """The share of these tasks whose condition names a machine of the topology or another task in its message."""
    decided = [
        *((task, "") for task in offloaded(scenario, inputs)),
        *((task, "Postponed") for task in postponed(inputs)),
        *((task, "InsufficientResources") for task in refused(inputs)),
        *((task, "Preempted") for task in preempted(inputs)),
    ]
    names = [node.name for node in scenario.nodes] + [task.key for task in inputs.tasks]
    named = [
        any(name in text for text in _messages(task, reason) for name in names if name != task.key)
        for task, reason in decided
    ]
    return sum(named) / len(named) if named else None


def chain_depth(inputs: RunInputs) -> int | None:
    """Tasks in the longest chain of operators: one that an operator asked for, which another one was launched for."""
    parents = {task.key: task.parent for task in inputs.tasks}
    return max((_depth(parents, key) for key in parents), default=None)


def _depth(parents: Mapping[str, str], key: str) -> int:
    depth = 0
    while key and depth < PARENTS_MAX:
        depth, key = depth + 1, parents.get(key, "")
    return depth


def _had_reason(task: TaskLife, reason: str) -> bool:
    return any(condition.reason == reason for condition in task.conditions)


def _messages(task: TaskLife, reason: str) -> Iterator[str]:
    """Messages of its condition Accepted; with a reason, only those of that reason."""
    for condition in task.conditions:
        if _is_acceptance(condition) and (not reason or condition.reason == reason):
            yield condition.message


def _is_acceptance(condition: TaskCondition) -> bool:
    return condition.type == "Accepted"


def _releases(inputs: RunInputs, task: TaskLife) -> Iterator[str]:
    """Releases that were on main for the task, commit by commit; bridges are everybody's."""
    for state in inputs.history:
        yield from (
            release
            for release, tasks in state.tasks.items()
            if task.key in tasks and release.rpartition("/")[2] != BRIDGE
        )


def _agents(inputs: RunInputs, task: TaskLife) -> set[str]:
    return {release.partition("/")[0] for release in _releases(inputs, task)}


def _lost_its_releases(inputs: RunInputs, task: TaskLife) -> bool:
    """Return whether a commit that named the task was followed by one that did not, before the task itself was gone."""
    named = [any(task.key in tasks for tasks in state.tasks.values()) for state in inputs.history]
    return any(before and not after for before, after in pairwise(named)) and _outlived(task)


def _outlived(task: TaskLife) -> bool:
    times = [condition.time for condition in task.conditions if condition.reason == "Preempted"]
    return task.deleted is None or bool(times and task.deleted > times[0])


def results(inputs: RunInputs) -> int | None:
    """Results of perception that crossed the broker; None when the observer was not there all the time."""
    log = inputs.broker
    if log is None or log.gaps or log.since > inputs.started or log.until < inputs.ended:
        return None
    return len(log.results)


def results_after_removal(inputs: RunInputs) -> int | None:
    """Results later than 2 s after the last tracker's pod was gone; None when there was none, or one still runs."""
    gone = [pod.deleted for pod in inputs.pods if pod.name.startswith(TRACKER)]
    if not gone or None in gone or not results(inputs) or inputs.broker is None:
        return None
    end = max(moment for moment in gone if moment is not None) + AFTER_REMOVAL_SECONDS * NANOSECONDS
    return sum(result.time > end for result in inputs.broker.results)


def track_identities(inputs: RunInputs) -> int | None:
    """Different identities in all results: 1 when one vehicle passed and kept its own."""
    log = inputs.broker
    identities = {track["id"] for result in (log.results if log else ()) for track in _tracks(result.text)}
    return len(identities) or None


def _tracks(text: str) -> list[Mapping[str, Any]]:
    try:
        return [track for track in json.loads(text)["tracks"] if "id" in track]
    except (ValueError, KeyError, TypeError):
        return []
