"""A run is shown as it goes on, in the words and with the times of its report; a fault of that is none of the run."""

from __future__ import annotations

import threading

import pytest

from robotkube.cli.live import moments
from scenarios.runner import waiting
from scenarios.runner.inputs import Plan
from scenarios.runner.reporting import showing, timeline
from scenarios.runner.reporting.showing import Showing, since
from tests.stages.live_platform import NOW, SECOND, LivePlatformInMemory, node, plan, pod, task


class Lines(list[str]):
    """Lines that can be waited for."""

    def __init__(self) -> None:
        super().__init__()
        self.came = threading.Condition()

    def __call__(self, line: str) -> None:
        with self.came:
            self.append(line)
            self.came.notify_all()

    def await_one(self, words: str) -> str:
        with self.came:
            assert self.came.wait_for(lambda: any(words in line for line in self), 10), self
            return next(line for line in self if words in line)


@pytest.fixture
def lines() -> Lines:
    return Lines()


def test_moments_are_lines_as_they_happen(lines: Lines, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(showing, "STEP_SECONDS", 0.01)
    platform = LivePlatformInMemory()
    shown = Showing(platform, lines, None)
    platform.put("nodes", node("vehicle-00"))
    with shown.going_on():
        assert platform.watches["pods"].synced.wait(10)
        platform.put("pods", pod("vehicle-00/bag-player-1", "bag-player"))
        platform.put("tasks", task("zero"))
        lines.await_one("task cloud-0/zero created")
        shown.begin(NOW - 5 * SECOND)
        platform.put("tasks", task("one"))
        platform.put("pods", pod("cloud-0/recorder-1", "recorder"))
        lines.await_one("recorder-1 running")
        event = [line for line in lines if "event:" in line][-1]
    assert event == "    4.500 s  event: vehicle-00, vehicle-01 within 400 m (lidar-proximity)"
    assert not any("bag-player" in line for line in lines), "what starts before the story is counted, not told"


def test_an_api_server_that_does_not_answer_does_not_end_the_run(lines: Lines) -> None:
    platform = LivePlatformInMemory()
    shown = Showing(platform, lines, None)
    platform.watches["tasks"].answers = False
    with shown.going_on():
        assert "what happens is not shown any more" in lines.await_one("nobody answers")


@pytest.mark.parametrize(
    ("moment", "started", "text"),
    [
        (NOW, None, "   11:06:40"),
        (NOW, NOW + SECOND, "   11:06:40"),
        (NOW + 5_044 * SECOND // 1000, NOW, "    5.044 s"),
    ],
)
def test_before_the_story_the_clock_and_then_the_reports_times(moment: int, started: int | None, text: str) -> None:
    assert since(moment, started) == text


def test_the_reports_timeline_has_the_same_words() -> None:
    document = plan("p", proposed=1, merged=2, observed=3, pull_request=4, commit="07a9365612abcdef")
    given = Plan(
        plan="p", subject=document["subject"], cause="task", tasks=(), events=(), started=None,
        proposed=document["proposed"], merged=document["merged"], observed=document["observed"], pull_request=4,
        commit=document["commit"], changed=tuple(document["changed"]), created=tuple(document["created"]), removed=(),
        error=None,
    )  # fmt: skip
    shown_moments = [(moment.time, moment.text) for moment in moments.of_plan(None, document, NOW)]
    assert shown_moments == [(moment.time, moment.text) for moment in timeline._of_plan(given, "deployment")]


def test_what_is_waited_for_is_said_once_until_something_else_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A log is no place for the same line every ten seconds."""
    monkeypatch.setattr(waiting, "PROGRESS_SECONDS", 0.0)
    missing = iter(["3 releases", "3 releases", "3 releases", "1 release", "1 release", ""])
    now = ""
    said: list[str] = []

    def reached() -> bool:
        nonlocal now
        now = next(missing)
        return not now

    waiting.wait_for("all releases", 10, reached, lambda: f"{now} missing\nmore", 0.0, said.append)
    assert said == ["waiting for all releases: 3 releases missing", "waiting for all releases: 1 release missing"]
