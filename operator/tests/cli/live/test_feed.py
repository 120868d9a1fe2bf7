"""What a platform does becomes moments, each once, and a picture that says when it may be old."""

from __future__ import annotations

import pytest

from robotkube.cli.live.feed import PLANS_AT_REST_SECONDS, PLANS_SECONDS, Feed, received
from robotkube.cli.live.moments import Moment
from robotkube.errors import UnavailableError
from tests.stages.live_platform import NOW, SECOND, LivePlatformInMemory, node, plan, pod, task


class Stage:
    """A feed of a platform in memory, and what it has told."""

    def __init__(self, with_rates: bool = False) -> None:
        self.platform = LivePlatformInMemory()
        self.told: list[Moment] = []
        self.feed = Feed(self.platform, self.told.append, lambda: self.platform.now, with_rates)

    def step(self, seconds: float = 0.0) -> list[str]:
        """What is told new, `seconds` later."""
        self.platform.now += round(seconds * SECOND)
        before = len(self.told)
        self.feed.step(0.0)
        return [moment.words for moment in self.told[before:]]


@pytest.fixture
def stage() -> Stage:
    stage = Stage()
    stage.platform.put("nodes", node("vehicle-00"))
    stage.platform.put("pods", pod("vehicle-00/mqtt-bridge-1", "mqtt-bridge"))
    stage.feed.start()
    return stage


def test_what_was_there_before_is_no_moment_but_the_tasks_that_stand() -> None:
    stage = Stage()
    stage.platform.put("tasks", task("one", ("Accepted", "True", "Accepted")))
    stage.platform.put("pods", pod("vehicle-00/mqtt-bridge-1", "mqtt-bridge"))
    stage.platform.plans = [plan("p0", proposed=-9, merged=-8, observed=-5)]
    stage.feed.start()
    assert stage.step() == ["task cloud-0/one stands: Accepted"]
    assert set(stage.feed.picture.plans) == {"p0"}


def test_an_encounter_is_told_as_it_happens_each_moment_once(stage: Stage) -> None:
    stage.step()
    stage.platform.put("tasks", task("one"))
    assert stage.step(0.1) == [
        "event: vehicle-00, vehicle-01 within 400 m (lidar-proximity)",
        "task cloud-0/one created",
    ]
    assert stage.told[0].time == NOW - SECOND // 2, "the event's own time, not when it was seen"
    stage.platform.plans = [plan("p1", proposed=0.4, merged=0.7, pull_request=4, commit="07a9365612abcdef")]
    stage.platform.put("tasks", task("one", ("Accepted", "True", "Accepted"), ("Committed", "False", "Proposed")))
    assert stage.step(PLANS_SECONDS) == [
        "deployment proposed: deploy(recording): vehicle-00, vehicle-01  #4",
        "deployment merged: releases: 1 new, 2 changed  #4  07a9365612",
    ]
    stage.platform.put("pods", pod("cloud-0/recorder-1", "recorder", "Pending", ready=False))
    stage.platform.put("pods", pod("cloud-0/recorder-1", "recorder", "Running", ready=False))
    assert stage.step() == ["pod cloud-0/recorder-1 created", "pod cloud-0/recorder-1 running"]
    stage.platform.plans[0]["observed"] = NOW + 5 * SECOND
    stage.platform.put("tasks", task("one", ("Accepted", "True", "Accepted"), ("Ready", "True", "Observed")))
    assert stage.step(PLANS_SECONDS) == [
        "task cloud-0/one ready",
        "deployment observed: synced and healthy  #4  07a9365612",
    ]
    stage.platform.put("tasks", None, "cloud-0/one")
    stage.platform.put("pods", None, "cloud-0/recorder-1")
    assert stage.step() == ["task cloud-0/one withdrawn", "pod cloud-0/recorder-1 gone"]
    assert stage.step(60) == []


def test_a_task_that_is_being_deleted_is_withdrawn_once(stage: Stage) -> None:
    one = task("one")
    stage.platform.put("tasks", one)
    stage.step()
    stage.platform.put("tasks", {**one, "metadata": {**one["metadata"], "deletionTimestamp": "2026-11-18T11:07:00Z"}})
    stage.platform.put("tasks", None, "cloud-0/one")
    assert stage.step() == ["task cloud-0/one withdrawn"]


@pytest.mark.parametrize(
    ("condition", "words"),
    [
        (("Accepted", "False", "NoCapableNode"), ["task cloud-0/one: NoCapableNode: words"]),
        (("Committed", "False", "ProposalRefused"), ["task cloud-0/one: ProposalRefused: words"]),
        (("Committed", "False", "Waiting"), []),
        (("Synced", "False", "Progressing"), []),
        (("Ready", "False", "Progressing"), []),
    ],
)
def test_what_somebody_should_look_at_is_told_with_its_words(
    stage: Stage, condition: tuple[str, str, str], words: list[str]
) -> None:
    stage.platform.put("tasks", task("one"))
    stage.step()
    stage.platform.put("tasks", task("one", condition))
    assert stage.step() == words
    assert [moment.trouble for moment in stage.told[2:]] == [True] * len(words)


def test_a_container_that_ended_is_told(stage: Stage) -> None:
    stage.step()
    stage.platform.put("pods", pod("vehicle-00/mqtt-bridge-1", "mqtt-bridge", restarts=1))
    [line] = stage.step()
    assert line == "pod vehicle-00/mqtt-bridge-1: a container ended and began again (Error, exit code 2)"


def test_a_persons_task_has_no_event(stage: Stage) -> None:
    stage.platform.put("tasks", task("one", rule="asked"))
    assert stage.step() == ["task cloud-0/one created: eva asks for recording"]


def test_pods_are_told_only_when_that_is_wanted(stage: Stage) -> None:
    stage.feed.tells_pods = False
    stage.platform.put("pods", pod("vehicle-00/bag-player-1", "bag-player"))
    assert stage.step() == []
    assert set(stage.feed.picture.pods) == {"vehicle-00/mqtt-bridge-1", "vehicle-00/bag-player-1"}


def test_plans_are_asked_for_often_only_while_something_goes_on(stage: Stage) -> None:
    """A view must not cost the platform what it shows."""
    stage.step()
    stage.platform.pages = 0
    for _ in range(60):
        stage.step(1)
    assert stage.platform.pages == 60 / PLANS_AT_REST_SECONDS
    stage.platform.plans = [plan("p1", proposed=0)]
    stage.step(PLANS_AT_REST_SECONDS)
    stage.platform.pages = 0
    for _ in range(20):
        stage.step(1)
    assert stage.platform.pages == 20 / PLANS_SECONDS


def test_a_manager_that_is_away_and_comes_back_is_told_once(stage: Stage) -> None:
    stage.platform.plans = [plan("p1", proposed=0, merged=1, observed=2)]
    stage.step()
    stage.platform.manager_answers = False
    [away] = stage.step(PLANS_AT_REST_SECONDS)
    assert away.startswith("what is shown may be old: the manager does not answer: no endpoints")
    assert stage.step(PLANS_AT_REST_SECONDS) == []
    assert stage.feed.picture.problem
    stage.platform.manager_answers = True
    stage.platform.plans = [plan("p1")]  # it has forgotten the times
    assert stage.step(PLANS_AT_REST_SECONDS) == ["what is shown is up to date again"]
    stage.platform.plans = [plan("p1", observed=2)]
    assert stage.step(PLANS_AT_REST_SECONDS) == [], "that it was observed has been known before"


def test_a_watch_that_is_interrupted_makes_the_picture_old(stage: Stage) -> None:
    stage.step()
    stage.platform.watches["pods"].complaint = "/api/v1/pods: nobody answers"
    assert stage.step() == ["what is shown may be old: /api/v1/pods: nobody answers"]


def test_an_api_server_that_does_not_answer_ends_it_at_the_beginning() -> None:
    stage = Stage()
    stage.platform.watches["tasks"].answers = False
    with pytest.raises(UnavailableError, match="tasks cannot be watched: nobody answers"):
        stage.feed.start()


METRICS = """# TYPE robotkube_detector_received_total counter
robotkube_detector_received_total{topic="/vehicles/{agent}/pose"} %d
robotkube_detector_lost_total{topic="/vehicles/{agent}/pose"} 3
"""


def test_rates_follow_from_two_readings_and_are_asked_for_with_a_view_alone() -> None:
    stage = Stage(with_rates=True)
    stage.platform.metrics = {"cloud-0/event-detector-1": METRICS % 1000}
    stage.feed.start()
    stage.step()
    assert stage.feed.picture.rates == {}
    stage.platform.metrics = {"cloud-0/event-detector-1": METRICS % 8500}
    stage.step(5)
    assert stage.feed.picture.rates == {"/vehicles/{agent}/pose": 1500.0}
    stage.platform.metrics = {"cloud-0/event-detector-1": METRICS % 10}  # it was restarted
    stage.step(5)
    assert stage.feed.picture.rates == {}


def test_counters_of_several_detectors_are_added() -> None:
    assert received([METRICS % 5, METRICS % 7, "nothing"]) == {"/vehicles/{agent}/pose": 12.0}
