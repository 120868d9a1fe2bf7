"""Chains of operators: a task launches an operator application, whose event detector writes tasks of its own.

A task names its parent (`spec.chain.parent`). That it may is checked, not believed: the parent's releases must include
a detector in the child's namespace that was set to write tasks for this parent. Depth is counted from the task without
a parent (0); a parent has at most FAN_OUT_MAX children, the oldest ones. When a task goes, its children count as
withdrawn, and theirs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.placement.scopes import OUTSIDE_SCOPE

DEPTH_MAX = 4
FAN_OUT_MAX = 16
CHAIN_TOO_DEEP = "ChainTooDeep"
CHAIN_TOO_WIDE = "ChainTooWide"
PARENT_WITHDRAWN = "ParentWithdrawn"
DETECTOR = "event-detector"


@dataclass(frozen=True, order=True)
class ChainTask:
    """A task as chains see it, ordered by age; `parent` is a task's key, empty for none."""

    created: str
    key: str
    namespace: str
    parent: str = ""


@dataclass(frozen=True)
class ChainRefusal:
    """The refusal of a task that is no part of its chain, or whose chain has ended."""

    reason: str
    message: str


def lineage(key: str, tasks: Mapping[str, ChainTask]) -> tuple[ChainTask, ...]:
    """A task and its ancestors, nearest first, at most DEPTH_MAX + 2 of them; the line ends where a parent is
    missing."""
    line: list[ChainTask] = []
    while key in tasks and len(line) < DEPTH_MAX + 2:
        line.append(tasks[key])
        key = tasks[key].parent
    return tuple(line)


def judge(
    tasks: Mapping[str, ChainTask], gone: Mapping[str, str], releases: Iterable[Release]
) -> dict[str, ChainRefusal]:
    """Refusals of the tasks that are no part of a chain that stands, by key.

    `tasks` are the standing ones by key; `gone` says of tasks why they do not stand although they are there (refused,
    expired); `releases` are main's. What is refused here takes its children along.
    """
    releases = tuple(releases)
    authors = _authors(releases)
    running = {cause.task for release in releases for cause in release.causes}
    refusals: dict[str, ChainRefusal] = {}
    children: dict[str, list[ChainTask]] = {}
    for task in sorted(tasks.values(), key=lambda t: t.created):
        if task.parent:
            children.setdefault(task.parent, []).append(task)
    for parent, listed in children.items():
        if parent in tasks and parent not in running:
            gone = {parent: "nothing of it is on main", **gone}
        elif parent in tasks and parent not in gone:
            refusals |= _of_parent(sorted(listed), tasks, authors.get(parent, frozenset()))
    return refusals | _ended(tasks, {**gone, **{key: r.message for key, r in refusals.items()}}, refusals)


def _of_parent(
    children: list[ChainTask], tasks: Mapping[str, ChainTask], authors: frozenset[str]
) -> dict[str, ChainRefusal]:
    """Refusals among the children of one parent; `authors` are the namespaces in which it launched a detector."""
    refusals: dict[str, ChainRefusal] = {}
    counted = 0
    for child in children:
        if child.namespace not in authors:
            refusals[child.key] = _no_author(child)
        elif len(lineage(child.key, tasks)) > DEPTH_MAX + 1:
            refusals[child.key] = _too_deep(child)
        elif counted == FAN_OUT_MAX:
            refusals[child.key] = _too_wide(child)
        else:
            counted += 1
    return refusals


def _ended(
    tasks: Mapping[str, ChainTask], gone: Mapping[str, str], refused: Mapping[str, ChainRefusal]
) -> dict[str, ChainRefusal]:
    """Refusals of the tasks below one that does not stand. A ring of parents has no beginning: none of it stands."""
    refusals: dict[str, ChainRefusal] = {}
    for key in tasks:
        if key in refused:
            continue
        above = lineage(key, tasks)[1:]
        last = lineage(key, tasks)[-1]
        broken = next((t.key for t in above if t.key in gone), last.parent)
        if broken:
            why = gone.get(broken, "it is withdrawn" if broken not in tasks else "its own chain has no beginning")
            refusals[key] = ChainRefusal(PARENT_WITHDRAWN, f"its chain has ended at {broken}: {why}")
    return refusals


def _no_author(child: ChainTask) -> ChainRefusal:
    return ChainRefusal(
        OUTSIDE_SCOPE,
        f"spec.chain.parent {child.parent}: no release of that task is an event detector in namespace "
        f"{child.namespace} that writes tasks for it; leave spec.chain out, or let the parent's application launch one",
    )


def _too_deep(child: ChainTask) -> ChainRefusal:
    return ChainRefusal(
        CHAIN_TOO_DEEP,
        f"the chain through {child.parent} is deeper than {DEPTH_MAX} tasks below the first; let an earlier operator "
        "ask for the application itself",
    )


def _too_wide(child: ChainTask) -> ChainRefusal:
    return ChainRefusal(
        CHAIN_TOO_WIDE,
        f"{child.parent} has {FAN_OUT_MAX} children already; withdraw one, or ask for several things by one task",
    )


def _authors(releases: Iterable[Release]) -> dict[str, frozenset[str]]:
    """The namespaces in which a detector that a task launched writes tasks for it (its value `detector.task`), by
    task."""
    namespaces: dict[str, frozenset[str]] = {}
    for release in releases:
        detector = release.values.get("detector") if release.chart == DETECTOR else None
        parent = detector.get("task") if isinstance(detector, Mapping) else None
        if isinstance(parent, str) and parent in {cause.task for cause in release.causes}:
            namespaces[parent] = namespaces.get(parent, frozenset()) | {release.namespace}
    return namespaces
