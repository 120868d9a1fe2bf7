"""The test of an installation: one recording is asked for by a task, a message of it is in the database, and it is
withdrawn again.

Whatever happens in between, the task is deleted at the end; should this process be killed, its lease ends it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.tasks.core.task_description import CONDITIONS
from robotkube.errors import RobotKubeError
from robotkube.setup.ports import AskedTask, RecordedEvents

ACCEPTED, COMMITTED, SYNCED, READY = CONDITIONS
RECORD_SECONDS_MAX = 34.0
END_SECONDS_MAX = 18.0
POLL_SECONDS = 0.5
"""Together with the start of its pod less than the 60 s that the Job has."""


@dataclass(frozen=True)
class TestClock:
    """The time in seconds that never go back, and a sleep that is false when the process shall end."""

    __test__ = False  # no test of pytest's, by its name

    now: Callable[[], float]
    sleep: Callable[[float], bool]


@dataclass(frozen=True)
class TestedPlatform:
    """The places to look at when something hangs: the platform's namespace, Argo CD's, and who asks for what."""

    __test__ = False

    namespace: str
    argocd: str
    asking: str
    application: str


@dataclass(frozen=True)
class InstallationResult:
    """How long it took until a message was in the database, and until recording and task had ended; `problem` says
    what failed and what to do, empty when nothing did."""

    recorded_seconds: float = 0.0
    ended_seconds: float = 0.0
    problem: str = ""


def try_installation(
    task: AskedTask, events: RecordedEvents, platform: TestedPlatform, clock: TestClock
) -> InstallationResult:
    """Ask, wait for the recording, withdraw, and wait for its end."""
    begin = clock.now()
    try:
        events.answers()
        task.ask()
        problem = _recorded(task, events, platform, clock, begin + RECORD_SECONDS_MAX)
    except RobotKubeError as error:
        problem = str(error)
    except BaseException:
        task.withdraw()
        raise
    recorded = clock.now()
    left = _ended(task, events, platform, clock, expects_end=not problem)
    return InstallationResult(recorded - begin, clock.now() - recorded, "; ".join(filter(None, (problem, left))))


def _recorded(
    task: AskedTask, events: RecordedEvents, platform: TestedPlatform, clock: TestClock, deadline: float
) -> str:
    """Wait until a message of the task's recording is in the database; why there is none."""
    document: Mapping[str, Any] | None = None
    fault = ""
    while True:
        try:
            document = task.read()
            if document is not None and (refusal := _refusal(document)):
                return refusal
            if events.messages():
                return ""
            fault = ""
        except RobotKubeError as error:
            if not error.retriable:
                raise
            fault = str(error)
        if clock.now() >= deadline:
            return fault or hanging(document, platform)
        if not clock.sleep(POLL_SECONDS):
            return "the test was ended from outside before anything was recorded"


def _ended(
    task: AskedTask, events: RecordedEvents, platform: TestedPlatform, clock: TestClock, expects_end: bool
) -> str:
    """Withdraw the task, and wait until it is gone and its recording has its end; what is left."""
    deadline = clock.now() + END_SECONDS_MAX
    left = ""
    while True:
        try:
            task.withdraw()
            gone = task.read() is None
            if gone and (not expects_end or events.ended()):
                return ""
            left = f"the recording of {platform.asking} has no end in the database; see the recorder's log"
            if not gone:
                left = f"task {platform.asking} is still there; robotkube task withdraw {platform.asking}"
        except RobotKubeError as error:
            left = f"whether task {platform.asking} is gone is not known: {error}"
            if not error.retriable:
                return left
        if clock.now() >= deadline or not clock.sleep(POLL_SECONDS):
            return f"{END_SECONDS_MAX:g} s after it was withdrawn, {left}"


def _refusal(document: Mapping[str, Any]) -> str:
    """Why the manager refuses the task; empty while it does not."""
    condition = _conditions(document).get(ACCEPTED, {})
    if condition.get("status") != "False":
        return ""
    return f"the manager refuses the task ({condition.get('reason')}): {condition.get('message')}"


def hanging(document: Mapping[str, Any] | None, platform: TestedPlatform) -> str:
    """What the task waits for after all its time, and where to look."""
    time = f"nothing was recorded within {RECORD_SECONDS_MAX:g} s: "
    if document is None:
        return f"{time}task {platform.asking} was deleted meanwhile by somebody else"
    conditions = _conditions(document)
    if ACCEPTED not in conditions:
        look = f"kubectl -n {platform.namespace} logs deployment/manager"
        return f"{time}no manager answered the task. Is one running, and is {platform.asking} in its scope? {look}"
    for kind, look in (
        (ACCEPTED, f"kubectl -n {platform.namespace} logs deployment/manager"),
        (COMMITTED, f"kubectl -n {platform.namespace} logs deployment/manager, and robotkube plan list"),
        (SYNCED, f"kubectl -n {platform.argocd} get applications"),
        (READY, f"robotkube task show {platform.asking}"),
    ):
        condition = conditions.get(kind, {})
        if condition.get("status") != "True":
            words = f"{condition.get('reason', 'no answer yet')}: {condition.get('message', '')}".rstrip(": ")
            return f"{time}the task is not {kind} ({words}). See {look}"
    return (
        f"{time}{platform.application} runs and is ready, and no message reached it. Do the agents that "
        "installationTest.parameters names send what it records? robotkube task show and their bridges' /status say so"
    )


def _conditions(document: Mapping[str, Any]) -> Mapping[str, Mapping[str, Any]]:
    """The conditions about the task as it is asked for now."""
    return {one["type"]: one for one in (document.get("status") or {}).get("conditions") or ()}
