"""What became of a chart's pods while they were under traffic, from the pods before and after."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robotkube.registry.suites.core.pod_descriptions import container_statuses

Pod = Mapping[str, Any]


def unsteady(before: Sequence[Pod], after: Sequence[Pod]) -> list[str]:
    """What did not stay as it was, as sentences: pods that went or came, containers that were started again or ended,
    readiness that was lost, also when it came back."""
    later = {_identity(pod): pod for pod in after}
    problems = [problem for pod in before for problem in _of_one(pod, later.pop(_identity(pod), None))]
    return problems + [f"pod {name} came while the chart ran" for name, _ in later]


def ends(before: Sequence[Pod], after: Sequence[Pod]) -> list[str]:
    """Which containers were started again or ended, as sentences, of pods that are still there."""
    later = {_identity(pod): pod for pod in after}
    pairs = ((pod, later.get(_identity(pod))) for pod in before)
    return [end for pod, present in pairs if present is not None for end in _ends(pod, present)]


def came(before: Sequence[Pod], after: Sequence[Pod]) -> bool:
    """Return whether there are pods, and each of them is a new one; those that go do not count any more."""
    present = {_identity(pod) for pod in after if not pod["metadata"].get("deletionTimestamp")}
    return bool(present) and not {_identity(pod) for pod in before} & present


def _identity(pod: Pod) -> tuple[str, str]:
    return str(pod["metadata"].get("name")), str(pod["metadata"].get("uid"))


def _of_one(before: Pod, after: Pod | None) -> Iterator[str]:
    name = before["metadata"].get("name")
    if after is None:
        yield f"pod {name} is gone: it was evicted, deleted or replaced"
        return
    yield from _ends(before, after)
    then, now = _readiness(before), _readiness(after)
    if now[0] != "True":
        yield f"pod {name} is not ready any more{f': {now[2]}' if now[2] else ''}"
    elif then[0] == "True" and now[1] != then[1]:
        yield f"pod {name} was not ready for a while, until {now[1]}"


def _ends(before: Pod, after: Pod) -> Iterator[str]:
    name = before["metadata"].get("name")
    starts = {status.get("name"): _starts(status) for status in container_statuses(before)}
    for status in container_statuses(after):
        yield from (f"pod {name}: container {text}" for text in _changes(starts.get(status.get("name"), 0), status))


def _starts(status: Mapping[str, Any]) -> int:
    return int(status.get("restartCount") or 0)


def _changes(starts: int, status: Mapping[str, Any]) -> Iterator[str]:
    again = _starts(status) - starts
    last = (status.get("lastState") or {}).get("terminated") or {}
    ended = (status.get("state") or {}).get("terminated")
    if again > 0:
        why = f"; it ended with {last.get('exitCode')} ({last.get('reason')})" if last else ""
        yield f"{status.get('name')} was started again {again} time{'s' if again > 1 else ''}{why}"
    elif ended and (ended.get("exitCode") or ended.get("reason") != "Completed"):
        yield f"{status.get('name')} ended with {ended.get('exitCode')} ({ended.get('reason')})"


def _readiness(pod: Pod) -> tuple[str, str, str]:
    """Status, since when, and why of the condition Ready."""
    conditions = (pod.get("status") or {}).get("conditions") or ()
    for condition in conditions:
        if condition.get("type") == "Ready":
            return tuple(str(condition.get(key) or "") for key in ("status", "lastTransitionTime", "message"))  # type: ignore[return-value]
    return "False", "", ""
