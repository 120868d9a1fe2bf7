"""Held changes: those that wait for devices that hold them.

A hold keeps all changes of releases on the agent, removals too: what stops a service in motion is as much a surprise as
what starts one. A release that moves away from a held agent is held at both ends, so that it never runs twice.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.plans import ADD, REMOVE, Change
from robotkube.delivery.tasks.core.holds import DeviceHold


def active_holds(holds: Iterable[DeviceHold], now_ns: int) -> dict[str, DeviceHold]:
    """The holds that last, by agent: of several (two Nodes, Node and message) the one that ends last."""
    return {hold.agent: hold for hold in sorted(holds) if hold.until_ns > now_ns}


def held(
    changes: Sequence[Change], holds: Iterable[DeviceHold], agents: Mapping[str, str], now_ns: int
) -> tuple[tuple[Change, ...], dict[str, DeviceHold]]:
    """The changes that may be made now, and the hold of each that waits, by path. `agents` is namespace -> agent."""
    active = active_holds(holds, now_ns)
    waiting = {c.path: active[agent] for c in changes if (agent := agents.get(c.release.namespace, "")) in active}
    leaving = [change for change in changes if change.kind == REMOVE and change.path in waiting]
    for change in changes:
        origin = next((left for left in leaving if change.kind == ADD and _moves(left, change)), None)
        if origin is not None:
            waiting.setdefault(change.path, waiting[origin.path])
    return tuple(c for c in changes if c.path not in waiting), waiting


def _moves(left: Change, added: Change) -> bool:
    """Return whether `added` is the release that goes with `left`, on another agent: nothing else differs."""
    before, after = left.release, added.release
    return (before.name, before.chart, _anywhere(before)) == (after.name, after.chart, _anywhere(after))


def _anywhere(release: Release) -> dict[str, Any]:
    return {key: value for key, value in release.values.items() if key != "placement"}


def waiting_tasks(changes: Iterable[Change], waiting: Mapping[str, DeviceHold]) -> dict[str, str]:
    """The tasks that wait for a hold, each with what it waits for in words: those whose demand on a release would
    begin, end or change."""
    texts: dict[str, list[str]] = {}
    for change in changes:
        if change.path in waiting:
            before = set(change.before.causes) if change.before else set()
            after = set(change.after.causes) if change.after else set()
            for task in {cause.task for cause in before ^ after}:
                texts.setdefault(task, []).append(f"{change.release.key}: {waiting[change.path].text}")
    return {task: "; ".join(sorted(lines)) for task, lines in texts.items()}
