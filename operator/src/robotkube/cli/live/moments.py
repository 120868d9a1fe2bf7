"""Moments: what came of tasks, plans and pods, as it follows from two looks at them.

What happened before the first look is no moment. The scenarios' timeline uses the same words.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.cli.live.fleet import PodLook
from robotkube.cli.terminal.printing import printable
from robotkube.delivery.tasks.core.mqtt_messages import RULE as ASKED
from robotkube.foundation.documents.core.times import time_ns
from robotkube.foundation.kubernetes.core.objects import is_withdrawn

COMMIT_CHARACTERS = 10
PLAN_NAMES = {"task": "deployment", "withdrawal": "removal"}
STEPS = ("proposed", "merged", "observed")

Document = Mapping[str, Any]


@dataclass(frozen=True)
class Moment:
    """Something that happened: when (ns since 1970), what, and the pull request and commit that it belongs to;
    `trouble`: somebody should look at it."""

    time: int
    text: str
    pull_request: int | None = None
    commit: str | None = None
    trouble: bool = False

    @property
    def words(self) -> str:
        """What happened, with pull request and commit."""
        request = f"  #{self.pull_request}" if self.pull_request else ""
        words = f"{self.text}{request}{f'  {self.commit[:COMMIT_CHARACTERS]}' if self.commit else ''}"
        return printable(words.replace("\n", " "))

    def document(self) -> dict[str, Any]:
        """The moment as JSON values."""
        return {
            "time": self.time,
            "what": self.text,
            "pull_request": self.pull_request,
            "commit": self.commit,
            "trouble": self.trouble,
        }


def of_task(key: str, before: Document | None, now: Document | None, seen: int) -> Iterator[Moment]:
    """What came of a task between two looks (None: it is not there), the second at `seen`."""
    gone = now is None or is_withdrawn(now)
    if gone:
        if before is not None and not is_withdrawn(before):
            yield Moment(seen, f"task {key} withdrawn")
        return
    assert now is not None
    if before is None:
        yield from _asked(key, now, seen)
    old = conditions(before or {})
    for kind, condition in conditions(now).items():
        if (old.get(kind, {}).get("status"), old.get(kind, {}).get("reason")) != (
            condition["status"],
            condition.get("reason"),
        ):
            yield from _condition(key, old.get(kind, {}), condition, seen)


def conditions(task: Document) -> dict[str, Document]:
    """A task's conditions by their type."""
    return {one["type"]: one for one in task.get("status", {}).get("conditions", [])}


def event_time(task: Document) -> int | None:
    """The time at which the event of a task was raised; None when it does not say."""
    try:
        return time_ns(task["spec"]["event"]["time"])
    except (KeyError, ValueError):
        return None


def _asked(key: str, task: Document, seen: int) -> Iterator[Moment]:
    spec = task.get("spec", {})
    rule = spec.get("event", {}).get("rule", "")
    if rule in ("", ASKED):
        what = spec.get("application") or f"any that provides {spec.get('provides')}"
        yield Moment(seen, f"task {key} created: {spec.get('requester', 'somebody')} asks for {what}")
        return
    why = f"{spec['reason']} ({rule})" if spec.get("reason") else f"rule {rule}"
    yield Moment(event_time(task) or seen, f"event: {why}")
    yield Moment(seen, f"task {key} created")


def _condition(key: str, before: Document, now: Document, seen: int) -> Iterator[Moment]:
    """What is told of a changed condition; that a task goes its way, its plan shows."""
    message = " ".join(str(now.get("message", "")).split())
    kind = now["type"]
    holds = now["status"] == "True"
    if kind == "Accepted" and not holds:
        yield Moment(seen, f"task {key}: {now.get('reason', '')}: {message}", trouble=True)
    elif kind == "Accepted" and before.get("status") == "False":
        yield Moment(seen, f"task {key} accepted: {message}")
    elif kind == "Ready" and holds:
        yield Moment(seen, f"task {key} ready")
    elif kind == "Ready" and before.get("status") == "True":
        yield Moment(seen, f"task {key} is not ready any more: {message}", trouble=True)
    elif kind == "Committed" and not holds and now.get("reason") not in ("Proposed", "Waiting"):
        yield Moment(seen, f"task {key}: {now.get('reason', '')}: {message}", trouble=True)


def of_plan(before: Document | None, now: Document, seen: int) -> Iterator[Moment]:
    """What came of a plan of the manager between two looks at `/plans`."""
    old = before or {}
    name = PLAN_NAMES.get(now["cause"], f"{now['cause']} plan")
    texts = {
        "proposed": f"{name} proposed: {now['subject']}",
        "merged": f"{name} merged: {releases_text(now['created'], now['changed'], now['removed'])}",
        "observed": observed_text(name),
    }
    for step in STEPS:
        if now.get(step) and not old.get(step):
            commit = now.get("commit") if step != "proposed" else None
            yield Moment(now[step], texts[step], now.get("pull_request"), commit)
    if now.get("error") and now["error"] != old.get("error"):
        yield Moment(seen, f"{name} failed: {now['error']}", now.get("pull_request"), trouble=True)


def observed_text(name: str) -> str:
    """What it means that a plan of this name is observed."""
    return f"{name} observed: {'Applications and pods gone' if name == 'removal' else 'synced and healthy'}"


def releases_text(created: Sequence[str], changed: Sequence[str], removed: Sequence[str]) -> str:
    """How many releases a plan makes, changes and takes away."""
    counted = (("new", created), ("changed", changed), ("removed", removed))
    parts = [f"{len(releases)} {word}" for word, releases in counted if releases]
    return f"releases: {', '.join(parts) or 'none'}"


def of_pod(before: PodLook | None, now: PodLook | None, seen: int) -> Iterator[Moment]:
    """What came of a pod between two looks (None: it is not there), the second at `seen`."""
    if now is None:
        if before is not None:
            yield Moment(seen, f"pod {before.key} gone")
        return
    if before is None:
        yield Moment(seen, f"pod {now.key} created")
    if now.running and not (before and before.running):
        yield Moment(seen, f"pod {now.key} running")
    if before is not None and now.restarts > before.restarts:
        yield Moment(seen, f"pod {now.key}: a container ended and began again ({now.ended})", trouble=True)
