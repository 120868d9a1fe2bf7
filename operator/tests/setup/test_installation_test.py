"""The test of an installation: what it waits for, that its task never stays, and the words for each failure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from robotkube.delivery.tasks.core.task_description import CONDITIONS, read_task
from robotkube.errors import InputError, UnavailableError
from robotkube.setup.adapters.installation_task import KubernetesTask
from robotkube.setup.loops.installation_test import (
    END_SECONDS_MAX,
    RECORD_SECONDS_MAX,
    InstallationResult,
    TestClock,
    TestedPlatform,
    try_installation,
)

ASKING = "cloud-0/installation-test-1"
PLATFORM = TestedPlatform("robotkube", "argocd", ASKING, "pose-point-cloud-recording")


def conditions(reached: int, reason: str = "Progressing", message: str = "m", status: str = "False") -> dict[str, Any]:
    """A task with so many of its conditions True, and the next one as said."""
    held = [{"type": kind, "status": "True", "reason": "R", "message": ""} for kind in CONDITIONS[:reached]]
    next_one = [{"type": kind, "status": status, "reason": reason, "message": message} for kind in CONDITIONS[reached:]]
    return {"status": {"conditions": [*held, *next_one[:1]]}}


READY = conditions(4)


class Stage:
    """A task, a database, and seconds that only sleeping moves: the first message comes after `after` of them, and the
    end of the recording `ends` after the withdrawal."""

    def __init__(
        self,
        task: Mapping[str, Any] = READY,
        after: float = 5.0,
        ends: float = 2.0,
        faults: Sequence[Exception | None] = (),
    ) -> None:
        self.faults = list(faults)  # of the database, one for each question; None: it answers
        self.task = task
        self.after = after
        self.ends = ends
        self.seconds = 0.0
        self.asked = False
        self.withdrawn_at = None
        self.stays = False
        self.going_on = True
        self.refused: Exception | None = None

    def ask(self) -> None:
        if self.refused:
            raise self.refused
        self.asked = True

    def read(self) -> Mapping[str, Any] | None:
        return self.task if self.asked and (self.withdrawn_at is None or self.stays) else None

    def withdraw(self) -> None:
        if self.withdrawn_at is None:
            self.withdrawn_at = self.seconds

    def answers(self) -> None:
        self._fail()

    def messages(self) -> bool:
        self._fail()
        return self.seconds >= self.after

    def ended(self) -> bool:
        return self.withdrawn_at is not None and self.seconds >= self.withdrawn_at + self.ends

    def _fail(self) -> None:
        if self.faults and (fault := self.faults.pop(0)):
            raise fault

    def sleep(self, seconds: float) -> bool:
        self.seconds += seconds
        return self.going_on

    def tried(self) -> InstallationResult:
        return try_installation(self, self, PLATFORM, TestClock(lambda: self.seconds, self.sleep))


def test_records_one_event_and_withdraws_it() -> None:
    stage = Stage()
    assert stage.tried() == InstallationResult(5.0, 2.0)
    assert (stage.asked, stage.withdrawn_at) == (True, 5.0)


def test_a_passing_fault_is_tried_again() -> None:
    stage = Stage(faults=[None, UnavailableError("the database is away")])
    assert stage.tried().problem == ""


@pytest.mark.parametrize(
    ("task", "words"),
    [
        ({}, "no manager answered the task. Is one running, and is cloud-0/installation-test-1 in its scope? kubectl"),
        (
            conditions(0, "WaitsForApproval", "needs approval", "Unknown"),
            "not Accepted (WaitsForApproval: needs approval",
        ),
        (conditions(1, "GateUnavailable", "no verdict"), "the task is not Committed (GateUnavailable: no verdict)"),
        (
            conditions(2, "Progressing", ""),
            "the task is not Synced (Progressing). See kubectl -n argocd get applications",
        ),
        (conditions(3, "Progressing", "container recorder cannot begin"), "not Ready (Progressing: container recorder"),
        (READY, "pose-point-cloud-recording runs and is ready, and no message reached it. Do the agents"),
    ],
)
def test_what_hangs_is_named(task: Mapping[str, Any], words: str) -> None:
    stage = Stage(task, after=1000)
    assert words in stage.tried().problem
    assert RECORD_SECONDS_MAX <= stage.seconds < RECORD_SECONDS_MAX + 2
    assert stage.withdrawn_at is not None


def test_a_refusal_ends_the_test_at_once() -> None:
    stage = Stage(conditions(0, "UnknownApplication", "the catalogue has no pose-point-cloud-recording"))
    problem = stage.tried().problem
    assert problem == (
        "the manager refuses the task (UnknownApplication): the catalogue has no pose-point-cloud-recording"
    )
    assert stage.seconds < 2
    assert stage.withdrawn_at is not None


@pytest.mark.parametrize("error", [InputError("403: may not create taskdescriptions"), UnavailableError("no answer")])
def test_a_task_that_cannot_be_made(error: Exception) -> None:
    stage = Stage()
    stage.refused = error
    assert stage.tried().problem == str(error)


def test_a_database_that_is_away_is_said_before_anything_is_asked_for() -> None:
    stage = Stage(faults=[UnavailableError("database, reading recording x: no answer")])
    assert stage.tried().problem == "database, reading recording x: no answer"
    assert not stage.asked


def test_a_recording_without_an_end() -> None:
    stage = Stage(ends=1000)
    problem = stage.tried().problem
    assert problem == (
        "18 s after it was withdrawn, the recording of cloud-0/installation-test-1 has no end in the database; "
        "see the recorder's log"
    )
    assert stage.seconds <= 5 + END_SECONDS_MAX + 1


def test_a_task_that_stays() -> None:
    stage = Stage()
    stage.stays = True
    assert "task cloud-0/installation-test-1 is still there; robotkube task withdraw" in stage.tried().problem


def test_a_test_that_is_ended_withdraws_its_task() -> None:
    stage = Stage()
    stage.going_on = False
    assert "the test was ended from outside" in stage.tried().problem
    assert stage.withdrawn_at is not None


def test_a_test_that_crashes_withdraws_its_task() -> None:
    stage = Stage()
    stage.messages = lambda: 1 / 0  # type: ignore[method-assign,assignment]
    with pytest.raises(ZeroDivisionError):
        stage.tried()
    assert stage.withdrawn_at is not None


def test_all_bounds_together_are_less_than_the_jobs_minute() -> None:
    assert RECORD_SECONDS_MAX + END_SECONDS_MAX <= 54


class Api:
    """An API server that keeps what it was told."""

    def __init__(self, answers: Sequence[bool] = (True,)) -> None:
        self.made: list[tuple[str, Mapping[str, Any]]] = []
        self.answers = list(answers)

    def create(self, path: str, body: Mapping[str, Any]) -> bool:
        self.made.append((path, body))
        return self.answers.pop(0)

    def get(self, path: str) -> dict[str, Any] | None:
        return None

    def delete(self, path: str) -> bool:
        return False


def test_the_task_is_one_that_the_manager_reads_and_ends_by_itself() -> None:
    api = Api([True, False])
    now = "2026-11-27T03:00:00.000000Z"
    task = KubernetesTask(api, "cloud-0", "installation-test-1", "recording", {"vehicles": ["vehicle-00"]}, now)
    task.ask()
    [(path, body)] = api.made
    assert path == "/apis/robotkube.io/v1alpha1/namespaces/cloud-0/taskdescriptions"
    read = read_task({**body, "metadata": {**body["metadata"], "uid": "u", "creationTimestamp": now, "generation": 1}})
    assert (read.key, read.application, read.parameters) == (ASKING, "recording", {"vehicles": ["vehicle-00"]})
    assert body["spec"]["lease"] == {"seconds": 120}
    with pytest.raises(InputError, match="there is a task cloud-0/installation-test-1 already"):
        task.ask()
    assert task.read() is None
