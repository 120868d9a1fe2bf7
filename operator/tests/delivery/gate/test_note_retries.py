"""A note that could not be written stays due; without a forge. With one: delivery/gate/test_plan_notes.py."""

from __future__ import annotations

import threading
from collections.abc import Collection, Mapping
from typing import Any, cast

import pytest

from robotkube.delivery.deployment.core.plan_notes import PlanOutcome, ReleaseOutcome, note_text, outcome_comment
from robotkube.delivery.gate.loops import plan_notes
from robotkube.delivery.gate.loops.plan_notes import NoteWriter
from robotkube.errors import UnavailableError
from robotkube.foundation.forge.ports.pull_requests import Comment, PullRequest

COMMIT = "a" * 40
FACTS = PlanOutcome(
    "p1",
    COMMIT,
    1,
    2,
    3,
    (
        ReleaseOutcome(
            "cloud-0/noted",
            "Synced",
            "Healthy",
            ("cloud-0",),
            (),
        ),
    ),
    (),
)


class Forge:
    """One merged pull request with its outcome comment; the next `away` requests are not answered."""

    away = 0

    def pull_request(self, number: int) -> PullRequest:
        if self.away:
            self.away -= 1
            raise UnavailableError("forge: no answer")
        return PullRequest(number, "", "", "manager", "closed", COMMIT, True)

    def pull_requests(self, state: str) -> list[PullRequest]:
        return []  # so many have been closed since that it is not among the newest

    def comments(self, number: int) -> list[Comment]:
        return [Comment("manager", outcome_comment(FACTS))]


class Notes:
    """The notes at the forge."""

    def __init__(self) -> None:
        self.known: dict[str, str] = {}
        self.written = threading.Event()

    def missing(self, commits: Collection[str]) -> list[str]:
        return [commit for commit in commits if commit not in self.known]

    def add(self, notes: Mapping[str, str]) -> None:
        self.known.update(notes)
        self.written.set()


def note_writer(forge: Forge, notes: Notes) -> NoteWriter:
    return NoteWriter(cast(Any, forge), cast(Any, notes), ["manager"], lambda: 0.0)


def test_what_failed_is_due_again() -> None:
    forge = Forge()
    notes = Notes()
    writer = note_writer(forge, notes)
    writer.commented(1)
    forge.away = 1
    with pytest.raises(UnavailableError):
        writer.round(resync=False)
    assert notes.known == {}
    writer.round(resync=False)
    assert notes.known == {COMMIT: note_text(FACTS)}
    writer.round(resync=False)
    assert writer.written == 1


def test_a_round_that_failed_is_repeated_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plan_notes, "RETRY_SECONDS_FIRST", 0.01)
    monkeypatch.setattr(plan_notes, "GATHER_SECONDS", 0.0)
    forge = Forge()
    notes = Notes()
    stopping = threading.Event()
    writer = note_writer(forge, notes)
    writer.commented(1)
    forge.away = 3
    thread = threading.Thread(target=writer.run, args=(stopping,))
    thread.start()
    assert notes.written.wait(30), "nobody comments any more"
    writer.stop(stopping)
    thread.join(30)
    assert (thread.is_alive(), forge.away) == (False, 0)
