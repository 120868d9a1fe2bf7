"""Steps of a story besides its players: what a person or a fault does, and the state that must come of it.

    - name: the edge server is full
      when: [{task: edge-0/first, reason: Merged}]          wait for this, then
      do: {submit: {namespace: edge-0, name: third, application: object-detection, parameters: {sensor: vehicle-02}}}
      until: [{task: edge-0/third, condition: Accepted, status: "False", reason: InsufficientResources}]
      seconds: 60                                           the bound of each of the two waits

Their form is checked by scenario.schema.json before they are read here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

STEP_SECONDS_MAX = 120.0
READY, MAIN, ABSENT = "ready", "main", "absent"
ACCEPTED = "Accepted"


@dataclass(frozen=True)
class TaskState:
    """A task (`<namespace>/<name>`) whose condition has a status and a reason; an empty word is any."""

    task: str
    condition: str = ACCEPTED
    status: str = ""
    reason: str = ""

    def __str__(self) -> str:
        return f"task {self.task}: {self.condition}={self.status or 'any'} {self.reason}".rstrip()


@dataclass(frozen=True)
class TaskCount:
    """At least `at_least` tasks in a namespace are Accepted; 0: there is none at all."""

    namespace: str
    at_least: int

    def __str__(self) -> str:
        return f"{self.at_least or 'no'} accepted tasks in {self.namespace}"


@dataclass(frozen=True)
class ReleaseState:
    """A release (`<namespace>/<name>`) that is on main, `ready` (observed, too), or `absent` from main and cluster."""

    release: str
    state: str

    def __str__(self) -> str:
        return f"release {self.release} {self.state}"


@dataclass(frozen=True)
class Heard:
    """At least `at_least` messages of a topic come on an agent's node, as its services hear them."""

    agent: str
    topic: str
    type_name: str
    at_least: int

    def __str__(self) -> str:
        return f"{self.at_least} messages of {self.topic} heard on {self.agent}"


State = TaskState | TaskCount | ReleaseState | Heard


@dataclass(frozen=True)
class Step:
    """One step: `when` all of these hold, `action` is done with `given`, and then `until` must come to hold. `seconds`
    bounds each wait. An empty `action` is a step that only waits."""

    name: str
    action: str
    given: Any
    when: tuple[State, ...]
    until: tuple[State, ...]
    seconds: float


def read_steps(given: Sequence[Mapping[str, Any]]) -> tuple[Step, ...]:
    """The steps of a checked document, in their order."""
    return tuple(_step(one) for one in given)


def _step(given: Mapping[str, Any]) -> Step:
    action, value = next(iter(given.get("do", {}).items()), ("", None))
    return Step(
        name=given["name"],
        action=action,
        given=value,
        when=tuple(_state(one) for one in given.get("when", ())),
        until=tuple(_state(one) for one in given.get("until", ())),
        seconds=given.get("seconds", STEP_SECONDS_MAX),
    )


def _state(given: Mapping[str, Any]) -> State:
    if "task" in given:
        return TaskState(**given)
    if "tasks" in given:
        return TaskCount(given["tasks"], given["at_least"])
    if "heard" in given:
        return Heard(given["at"], given["heard"], given["type"], given["at_least"])
    return ReleaseState(given["release"], given["is"])
