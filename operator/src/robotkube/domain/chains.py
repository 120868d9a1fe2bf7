"""Chains of operators: a task launches an operator application, whose event detector writes tasks of its own.

A task names its parent (`spec.chain.parent`). That it may is checked, not believed: the parent's releases must include
a detector in the child's namespace that was told to write tasks for this parent. Depth is counted from the task without
a parent (0); a parent has at most FAN_OUT_MAX children, the oldest ones. When a task goes, its children count as
withdrawn, and theirs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from robotkube.domain.releases import Release
from robotkube.domain.scopes import OUTSIDE_SCOPE

DEPTH_MAX = 4
FAN_OUT_MAX = 16
CHAIN_TOO_DEEP, CHAIN_TOO_WIDE, PARENT_WITHDRAWN = "ChainTooDeep", "ChainTooWide", "ParentWithdrawn"
DETECTOR = "event-detector"


@dataclass(frozen=True, order=True)
class ChainTask:
    """What of a task matters to chains, in the order of age; `parent` is a task's key, empty for none."""

    created: str
    key: str
    namespace: str
    parent: str = ""


@dataclass(frozen=True)
class ChainRefusal:
    """Why a task is no part of its chain, or that its chain has ended."""

    reason: str
    message: str


def lineage(key: str, tasks: Mapping[str, ChainTask]) -> tuple[ChainTask, ...]:
    """A task and its ancestors, nearest first, at most DEPTH_MAX + 2 of them; shorter than to the root when a parent is
    missing."""
    found: list[ChainTask] = []
    while key in tasks and len(found) < DEPTH_MAX + 2:
        found.append(tasks[key])
        key = tasks[key].parent
    return tuple(found)


def judge(
    tasks: Mapping[str, ChainTask], gone: Mapping[str, str], releases: Iterable[Release]
) -> dict[str, ChainRefusal]:
    """A refusal for every task that is no part of a chain that stands.

    `tasks` are the standing ones by key; `gone` says of tasks why they do not stand although they are there (refused,
    expired); `releases` are main's. What is refused here takes its children along.
    """
    releases = tuple(releases)
    authors, running = _authors(releases), {cause.task for release in releases for cause in release.causes}
    found: dict[str, ChainRefusal] = {}
    children: dict[str, list[ChainTask]] = {}
    for task in sorted(tasks.values(), key=lambda t: t.created):
        if task.parent:
            children.setdefault(task.parent, []).append(task)
    for parent, listed in children.items():
        if parent in tasks and parent not in running:
            gone = {parent: "nothing of it is on main", **gone}
        elif parent in tasks and parent not in gone:
            found |= _of_parent(sorted(listed), tasks, authors.get(parent, frozenset()))
    return found | _ended(tasks, {**gone, **{key: r.message for key, r in found.items()}}, found)


def _of_parent(
    children: list[ChainTask], tasks: Mapping[str, ChainTask], authors: frozenset[str]
) -> dict[str, ChainRefusal]:
    """Refusals among the children of one parent; `authors` are the namespaces in which it launched a detector."""
    found: dict[str, ChainRefusal] = {}
    counted = 0
    for child in children:
        if child.namespace not in authors:
            found[child.key] = _no_author(child)
        elif len(lineage(child.key, tasks)) > DEPTH_MAX + 1:
            found[child.key] = _too_deep(child)
        elif counted == FAN_OUT_MAX:
            found[child.key] = _too_wide(child)
        else:
            counted += 1
    return found


def _ended(
    tasks: Mapping[str, ChainTask], gone: Mapping[str, str], refused: Mapping[str, ChainRefusal]
) -> dict[str, ChainRefusal]:
    """Tasks below one that does not stand. A ring of parents has no beginning, so none of it stands."""
    found: dict[str, ChainRefusal] = {}
    for key in tasks:
        if key in refused:
            continue
        above = lineage(key, tasks)[1:]
        last = lineage(key, tasks)[-1]
        broken = next((t.key for t in above if t.key in gone), last.parent)
        if broken:
            why = gone.get(broken, "it is withdrawn" if broken not in tasks else "its own chain has no beginning")
            found[key] = ChainRefusal(PARENT_WITHDRAWN, f"its chain has ended at {broken}: {why}")
    return found


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
    """Task -> namespaces in which a detector that it launched writes tasks for it (its value `detector.task`)."""
    found: dict[str, frozenset[str]] = {}
    for release in releases:
        detector = release.values.get("detector") if release.chart == DETECTOR else None
        parent = detector.get("task") if isinstance(detector, Mapping) else None
        if isinstance(parent, str) and parent in {cause.task for cause in release.causes}:
            found[parent] = found.get(parent, frozenset()) | {release.namespace}
    return found
