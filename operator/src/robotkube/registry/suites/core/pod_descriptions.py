"""Diagnostics of pods and Deployments: states, warnings and last log lines, as sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robotkube.foundation.documents.core.shortening import shortened

EVENTS_MAX = 5
LOG_LINES_MAX = 12
LINE_CHARACTERS_MAX = 300
HOPELESS = frozenset(
    [
        *("CreateContainerConfigError", "ErrImageNeverPull", "ImageInspectError", "ImagePullBackOff"),
        *("InvalidImageName", "SignatureValidationFailed"),
    ]
)  # reasons why a container waits that no waiting ends
BACK_OFF = "CrashLoopBackOff"
KILLED = 137  # 128 + SIGKILL

Object = Mapping[str, Any]


def deployment_ready(item: Object) -> bool:
    """Return whether the newest pods, and only they, are there and available."""
    status = item.get("status") or {}
    wanted = (item.get("spec") or {}).get("replicas", 1)
    current = status.get("observedGeneration", 0) >= item["metadata"].get("generation", 0)
    counts = [status.get(key) or 0 for key in ("replicas", "updatedReplicas", "availableReplicas")]
    return bool(current and all(count == wanted for count in counts))


def pod_ready(item: Object) -> bool:
    """Return whether the pod's condition Ready is true."""
    conditions = (item.get("status") or {}).get("conditions") or ()
    return any(condition.get("type") == "Ready" and condition.get("status") == "True" for condition in conditions)


def pod_hopeless(item: Object) -> bool:
    """Return whether a container waits for what will not come, its image or a Secret that is not there, or ended twice:
    who ends once may have come too early."""
    return any(map(_hopeless, container_statuses(item)))


def _hopeless(status: Object) -> bool:
    reason = ((status.get("state") or {}).get("waiting") or {}).get("reason")
    return reason in HOPELESS or (reason == BACK_OFF and status.get("restartCount", 0) >= 1)


def pod_ended(item: Object) -> bool:
    """Return whether all containers have ended for good."""
    return (item.get("status") or {}).get("phase") in ("Succeeded", "Failed")


def container_statuses(item: Object) -> list[Object]:
    """Statuses of all containers, those that prepare the pod first."""
    status = item.get("status") or {}
    return [*(status.get("initContainerStatuses") or ()), *(status.get("containerStatuses") or ())]


def exit_codes(item: Object) -> dict[str, int | None]:
    """Container -> exit code; None when it was not seen to end."""
    codes: dict[str, int | None] = {}
    for status in (item.get("status") or {}).get("containerStatuses") or ():
        ended = (status.get("state") or {}).get("terminated")
        codes[str(status.get("name"))] = ended.get("exitCode") if ended else None
    return codes


def describe_deployment(item: Object | None, name: str) -> list[str]:
    """The failures in a Deployment's conditions, as lines."""
    if item is None:
        return [f"Deployment {name} is not there"]
    lines = []
    for condition in (item.get("status") or {}).get("conditions") or ():
        if condition.get("type") == "ReplicaFailure" and condition.get("status") == "True":
            lines.append(f"Deployment {name}: {condition.get('reason')}: {_short(condition.get('message'))}")
    return lines


def troubled(item: Object) -> bool:
    """Return whether the pod is not ready, or a container of it did not stay what it was started as."""
    return not pod_ready(item) or any(status.get("restartCount") for status in container_statuses(item))


def in_trouble_last(pods: Sequence[Object]) -> list[Object]:
    """The pods in another order: texts are cut in their middle, so what is said of the last ones stays."""
    return sorted(pods, key=troubled)


def describe_pod(item: Object, events: Sequence[Object] = ()) -> list[str]:
    """A pod's states, how containers ended first, and its last warnings."""
    name = item["metadata"]["name"]
    lines = [f"pod {name}: {text}" for text in _states(item)] or [f"pod {name}: {_phase(item)}"]
    return lines + describe_warnings(events)


def describe_warnings(events: Sequence[Object]) -> list[str]:
    """The last warnings among events, as lines."""
    warnings = [event for event in events if event.get("type") == "Warning"]
    return [f"event {event.get('reason')}: {_short(event.get('message'))}" for event in warnings[-EVENTS_MAX:]]


def last_lines(log: str) -> list[str]:
    """The last lines of a log under a heading; none of an empty one."""
    tail = [line for line in log.splitlines() if line.strip()][-LOG_LINES_MAX:]
    return ["last lines of its log:", *(f"  {_short(line)}" for line in tail)] if tail else []


def _phase(item: Object) -> str:
    status = item.get("status") or {}
    conditions = [condition for condition in status.get("conditions") or () if condition.get("status") == "False"]
    messages = "; ".join(_short(condition["message"]) for condition in conditions if condition.get("message"))
    return f"{status.get('phase', 'unknown')}{', ' + messages if messages else ''}"


def _states(item: Object) -> Iterator[str]:
    for status in container_statuses(item):
        name = status.get("name")
        state = status.get("state") or {}
        restarts = status.get("restartCount", 0)
        last = (status.get("lastState") or {}).get("terminated")
        if restarts and last:
            times = f"{restarts} time{'s' if restarts > 1 else ''}"
            yield f"container {name} was restarted {times}; it ended with {last.get('exitCode')} ({last.get('reason')})"
        if waiting := state.get("waiting"):
            yield f"container {name} waits: {_waiting(waiting)}"
        elif ended := state.get("terminated"):
            yield f"container {name} ended with {ended.get('exitCode')} ({ended.get('reason')})"
        elif not status.get("ready"):
            yield f"container {name} runs but is not ready: its readiness or startup probe does not succeed"


def _waiting(state: Object) -> str:
    """Why a container waits; for how long a container that ended is not started says nothing."""
    reason = str(state.get("reason"))
    return reason if reason == BACK_OFF else f"{reason}: {_short(state.get('message'))}"


def _short(text: Any) -> str:
    return shortened(" ".join(str(text or "").split()), LINE_CHARACTERS_MAX)
