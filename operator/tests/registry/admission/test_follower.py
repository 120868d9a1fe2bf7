"""A reconciler that lasts: what it says while main cannot be followed, and when it is ready."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from robotkube.errors import UnavailableError
from robotkube.registry.admission.core.listing import AllowedVersions
from robotkube.registry.admission.loops import follower as module
from robotkube.registry.admission.loops.follower import Follower
from tests.stages.waiting import until

FIRST, SECOND = "1" * 40, "2" * 40


class CataloguePolicies:
    """Port Reconciler: main as it stands, and faults of reading and writing."""

    def __init__(self) -> None:
        self.tip = ""
        self.written: AllowedVersions | None = None
        self.main = ""
        self.away = ""
        self.refused = ""
        self.steps = 0

    def step(self) -> bool:
        self.steps += 1
        if self.refused:
            raise UnavailableError(self.refused)
        if self.written is None:
            self.written = AllowedVersions()
        if self.away:
            raise UnavailableError(self.away)
        self.tip = self.main
        changed = self.written.commit != self.main
        self.written = AllowedVersions(("app@x",), ("a", "b"), commit=self.main)
        return changed


class Stage:
    def __init__(self) -> None:
        self.now = 100.0
        self.followed = CataloguePolicies()
        self.follower = Follower(self.followed, lambda: self.now)

    @property
    def reasons(self) -> list[str]:
        return list(self.follower.reasons_not_ready())

    def metric(self, name: str, *labels: str) -> float:
        [series] = [one for one in self.follower.metrics() if one.name == f"robotkube_admission_{name}"]
        return series.values[labels]


def test_it_is_ready_when_the_list_is_that_of_main_as_it_was_seen_last() -> None:
    stage = Stage()
    assert stage.reasons == ["no list was written yet"]
    stage.followed.refused = "the API server is away"
    assert not stage.follower.step()
    assert stage.reasons == ["no list was written yet: the API server is away"]
    stage.followed.refused, stage.followed.away = "", "the forge is away"
    assert not stage.follower.step()
    assert stage.reasons == ["main of the catalogue was not read yet: the forge is away"]
    stage.followed.away = ""
    stage.followed.main = FIRST
    assert stage.follower.step()
    assert stage.reasons == []
    assert (stage.metric("listed", "charts"), stage.metric("listed", "images"), stage.metric("behind")) == (1, 2, 0)
    assert (stage.metric("writes_total"), stage.metric("failures_total")) == (1, 2)


def test_while_the_forge_is_away_the_last_list_counts_and_its_age_is_told() -> None:
    stage = Stage()
    stage.followed.main = FIRST
    stage.follower.step()
    stage.followed.away = "the forge is away"
    stage.now += 70
    stage.follower.step()
    assert stage.reasons == []
    assert stage.metric("unconfirmed_seconds") == 70
    stage.followed.away = ""
    stage.follower.step()
    assert stage.metric("unconfirmed_seconds") == 0


def test_a_list_that_is_known_to_be_older_than_main_is_not_ready() -> None:
    """By what the forge announced although it does not answer now, or by what could not be written."""
    stage = Stage()
    stage.followed.main = FIRST
    stage.follower.step()
    stage.followed.away = "the forge is away"
    stage.followed.main = SECOND
    stage.follower.wake(SECOND)
    stage.follower.step()
    assert stage.reasons == [f"the list is that of {FIRST[:12]}, main is at {SECOND[:12]}: the forge is away"]
    assert stage.metric("behind") == 1
    stage.followed.away = ""
    stage.follower.step()
    assert stage.reasons == []
    stage.followed.tip = FIRST
    stage.followed.refused = "too many entries"
    stage.follower.step()
    assert stage.reasons == [f"the list is that of {SECOND[:12]}, main is at {FIRST[:12]}: too many entries"]


def test_a_problem_is_said_once_and_its_end_too(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    stage = Stage()
    for away in ("one", "one", "two", "", ""):
        stage.followed.away = away
        stage.now += 5
        stage.follower.step()
    stays = "admission: the policies stay as they are"
    again = "admission: main is followed again after_seconds=20"
    assert [record.getMessage() for record in caplog.records] == [f"{stays}: one", f"{stays}: two", again]


def test_what_is_no_passing_fault_ends_it() -> None:
    stage = Stage()
    stage.followed.step = lambda: {}["programming"]  # type: ignore[method-assign]
    with pytest.raises(KeyError):
        stage.follower.step()


def test_it_steps_when_it_is_woken_and_by_itself_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    stage = Stage()
    with running(stage, monkeypatch, 3600.0):
        until(lambda: stage.followed.steps == 1)
        stage.follower.wake()
        until(lambda: stage.followed.steps == 2)
    with running(stage, monkeypatch, 0.01):
        until(lambda: stage.followed.steps > 5, "polling")


@contextmanager
def running(stage: Stage, monkeypatch: pytest.MonkeyPatch, seconds: float) -> Iterator[None]:
    """The follower on a thread, which ends when it is told so."""
    monkeypatch.setattr(module, "RESYNC_SECONDS", seconds)
    stopping = threading.Event()
    thread = threading.Thread(target=stage.follower.run, args=(stopping,))
    thread.start()
    try:
        yield
    finally:
        stopping.set()
        stage.follower.wake()
        thread.join(10)
    assert not thread.is_alive()
