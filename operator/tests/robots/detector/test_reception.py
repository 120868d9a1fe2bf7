"""Reception goes on: beside a rule that sleeps, while the detector rests, over changed settings, jumps and silence."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robotkube.robots.detector.core.settings import read_detector_settings
from robotkube.robots.ros.core.qos import (
    IncompatiblePublishers,
    PublisherOffer,
    QosProfile,
    QosViolations,
    RequestedQos,
    matching_profile,
    mismatch,
)
from robotkube.robots.rules.adapters.child_processes import ChildProcess
from robotkube.robots.rules.loops.workers import RuleWorkers
from tests.stages.detector.in_memory import MS, NOW, SECOND, DetectorStage, MemoryTasks, pose
from tests.stages.detector.proximity_settings import SETTINGS
from tests.stages.detector.rules import NUMBER
from tests.stages.waiting import until

POSE_TYPE = "geometry_msgs/msg/PoseStamped"
PLAIN = {key: value for key, value in SETTINGS.items() if key != "reactions"}
TOPIC = "/vehicles/vehicle_00/pose"
SLEEPER = """
import time
from robotkube.robots.rules.adapters.child_processes import serve

def load(job):
    def answer(question):
        time.sleep(600)
        return []
    return answer

serve(load)
"""


@pytest.fixture
def stage() -> Iterator[DetectorStage]:
    stage = DetectorStage(MemoryTasks())
    yield stage
    stage.close()


def names(stage: DetectorStage) -> list[str]:
    return [event["rule"] for event in stage.events()]


def workers(stage: DetectorStage) -> dict[str, Any]:
    workers: dict[str, Any] = stage.status.document()["rules"]["workers"]
    return workers


class Unawaited(ChildProcess):
    """One for whose replies nobody waits."""

    def wait(self, seconds: float) -> None:
        raise AssertionError(f"reception waits for a rule, up to {seconds} s")


def test_a_rule_that_sleeps_holds_nothing_up(tmp_path: Path) -> None:
    """500 messages at full speed beside it: all in the buffer at once, all other rules evaluated. For the rule no time
    passes, so that it is not suspended, however slow the machine."""
    script = tmp_path / "sleeper.py"
    script.write_text(SLEEPER)
    processes: list[ChildProcess] = []

    def start(rule: Any) -> ChildProcess:
        processes.append(Unawaited({}, 0.1, [sys.executable, str(script)]))
        return processes[-1]

    stage = DetectorStage(MemoryTasks(), lambda: RuleWorkers(start, lambda: 0.0))
    sleeper = {"name": "slow", "kind": "python", "plugin": "sleeper", "topics": ["/vehicles/{agent}/pose"]}
    stage.apply({**PLAIN, "rules": [*PLAIN["rules"], sleeper]}, adopting=False)
    until(lambda: workers(stage)["slow"]["state"] == "running")
    for number in range(250):
        stage.send("vehicle-00", 0)
        stage.send("vehicle-01", 100 if number % 2 else 900)
    buffers = stage.detector.pool.snapshot()
    slow = workers(stage)["slow"]
    stage.detector.stop()
    assert (slow["answered"], slow["asked"], slow["waiting"]) == (0, 500, 500), "it has not answered once by then"
    assert [buffers[name]["messages"] for name in sorted(buffers)] == [250, 250]
    assert len(stage.events()) == 249
    assert len(processes) == 1


def test_changed_rules_keep_the_buffers(stage: DetectorStage) -> None:
    stage.apply(PLAIN)
    for _ in range(50):
        stage.send("vehicle-00", 0)
    before = stage.detector.pool.snapshot()[TOPIC]["messages"]
    stage.apply({**PLAIN, "rules": [{**PLAIN["rules"][0], "start_distance_m": 300}]})
    stage.send("vehicle-00", 0)
    assert (before, stage.detector.pool.snapshot()[TOPIC]["messages"]) == (50, 51)


def test_states_end_events_and_close_subscriptions(stage: DetectorStage) -> None:
    stage.apply(PLAIN)
    stage.send("vehicle-00", 0)
    stage.send("vehicle-01", 100)
    stage.detector.change_state("buffering")
    stage.send("vehicle-01", 100)
    assert [event["edge"] for event in stage.events()] == ["start", "stop"]
    assert stage.detector.pool.snapshot()["/vehicles/vehicle_01/pose"]["messages"] == 2
    stage.detector.change_state("inactive")
    assert all(topic.closed for topic in stage.live.topics.values())
    assert (stage.detector.subscribed, stage.status.not_ready()) == (0, "")
    stage.detector.change_state("active")
    stage.send("vehicle-00", 0)
    stage.send("vehicle-01", 100)
    assert [event["edge"] for event in stage.events()] == ["start", "stop", "start"]
    assert 'robotkube_detector_info{state="active"} 1' in stage.status.metrics()


def test_settings_decide_the_state_until_they_are_overruled(stage: DetectorStage) -> None:
    stage.apply({**PLAIN, "state": "inactive"})
    assert (stage.detector.state, stage.live.topics) == ("inactive", {})
    stage.detector.change_state("active")
    stage.apply({**PLAIN, "state": "inactive", "rules": []})
    assert stage.detector.state == "active", "the settings say of the state what they said before"
    stage.apply({**PLAIN, "state": "buffering"})
    assert stage.detector.state == "buffering"


def test_a_detector_that_only_buffers_raises_with_the_first_message_once_active(stage: DetectorStage) -> None:
    """Subscriptions and buffers are there already and stay; the change says when it was asked for and since when."""
    stage.apply({**PLAIN, "state": "buffering"})
    stage.send("vehicle-00", 0)
    stage.send("vehicle-01", 100)
    before = dict(stage.live.topics)
    assert stage.events() == []
    stage.now += 50 * MS
    stage.detector.change_state("active", stage.now - 20 * MS)
    assert stage.live.topics == before, "the same subscriptions"
    assert stage.detector.pool.snapshot()[TOPIC]["messages"] == 1
    stage.send("vehicle-00", 0)
    stage.send("vehicle-01", 100)
    assert [event["edge"] for event in stage.events()] == ["start"]
    status = stage.status.document()
    assert status["state_since"] - status["state_asked"] == 20 * MS


def test_settings_switch_to_rest_and_back_and_the_buffers_stay(stage: DetectorStage) -> None:
    stage.apply(PLAIN)
    stage.send("vehicle-00", 0)
    stage.send("vehicle-01", 100)
    first = dict(stage.live.topics)
    stage.apply({**PLAIN, "state": "inactive"})
    assert all(topic.closed for topic in first.values())
    assert ([event["edge"] for event in stage.events()], stage.live.announced) == (["start", "stop"], [])
    narrow = {**PLAIN["topics"][0], "buffer": {"seconds": 0.01}}
    stage.apply({**PLAIN, "state": "inactive", "topics": [narrow]})
    asked = stage.now
    stage.now += 7
    stage.detector.apply(read_detector_settings({**PLAIN, "topics": [narrow]}, "config.yaml"), asked)
    assert stage.live.announced == ["/vehicles/{agent}/pose"]
    assert stage.detector.reached == ("active", asked, asked + 7)
    stage.send("vehicle-00", 0)
    stage.send("vehicle-00", 0)
    counters = stage.detector.pool.snapshot()[TOPIC]
    assert (counters["messages"], counters["evicted_seconds"], counters["received"]) == (2, 1, 3), "the new bounds"
    stage.apply({**PLAIN, "state": "inactive", "topics": [narrow]})
    stage.apply({"name": PLAIN["name"], "topics": [{**narrow, "type": NUMBER}], "state": "inactive"})
    assert stage.detector.pool.snapshot() == {}, "messages of another type are no use"


def test_a_changed_topic_keeps_its_buffer_within_the_new_bounds(stage: DetectorStage) -> None:
    """The subscription stays, too, unless another one is asked for; then what it still held is taken first."""
    topic = PLAIN["topics"][0]
    stage.apply({**PLAIN, "topics": [{**topic, "buffer": {"seconds": 60}}]})
    for _ in range(100):
        stage.send("vehicle-00", 0)
    first = stage.live.topics[TOPIC]
    stage.apply({**PLAIN, "topics": [{**topic, "buffer": {"seconds": 0.2}, "stale_seconds": 1}]})
    assert (stage.live.topics[TOPIC], first.closed) == (first, False)
    counters = stage.detector.pool.snapshot()[TOPIC]
    assert (counters["messages"], counters["received"], counters["evicted_seconds"]) == (21, 100, 79)
    first.waiting.append((pose(stage.now + MS, 0), stage.now))
    first.lost = 3
    wide = {**topic, "name": TOPIC, "buffer": {"seconds": 60}, "depth": 7}
    stage.apply({**PLAIN, "topics": [topic, wide]})
    assert stage.live.topics[TOPIC] is not first
    stage.live.topics[TOPIC].waiting.append((pose(stage.now + 2 * MS, 0), stage.now))
    stage.live.topics[TOPIC].lost += 1
    stage.detector.turn()
    assert first.closed
    assert stage.detector.pool.snapshot()[TOPIC]["messages"] == 23
    assert [sample.stamp for sample in stage.detector.pool.buffers[TOPIC].samples()][-2:] == [
        stage.now + MS, stage.now + 2 * MS]  # fmt: skip
    shown = stage.status.document()["topics"][TOPIC]
    assert (shown["pattern"], shown["lost"]) == (TOPIC, 4), "counters only grow"
    stage.apply({**PLAIN, "rules": [], "topics": [{**wide, "source": "mqtt"}]})
    assert stage.detector.pool.snapshot()[TOPIC]["messages"] == 23, "another way to the same messages"


def test_a_jump_of_time_is_an_event_of_its_own(stage: DetectorStage) -> None:
    hook = {"rule": "time-jump", "kind": "mqtt", "topic": "jumps"}
    stage.apply({**PLAIN, "reactions": [hook]})
    for _ in range(20):
        stage.send("vehicle-00", 0)
    for _ in range(20):
        stage.send("vehicle-00", 0, age_ms=3_600_000)
    assert names(stage) == ["time-jump", "time-jump"]
    assert [delivery.edge for delivery in stage.reactions["mqtt time-jump jumps"].told] == ["start", "stop"]
    assert stage.detector.pool.snapshot()[TOPIC]["jumps"] == 1


def test_recordings_get_what_is_new_and_hear_of_events(stage: DetectorStage) -> None:
    topic = {"name": "/vehicles/{agent}/pose", "storage": "document", "before_seconds": 2, "after_seconds": 1}
    reaction = {"rule": "near", "kind": "recording", "recording": "r", "volume": "v", "topics": [topic]}
    stage.apply({**PLAIN, "reactions": [reaction]})
    stage.send("vehicle-00", 0)
    stage.live.topics[TOPIC].waiting *= 2
    stage.send("vehicle-01", 100)
    stage.send("vehicle-01", 900)
    [recordings] = stage.recordings
    assert (recordings.plan.always, recordings.plan.topics[0].before_seconds) == (False, 2)
    assert [name for name, _ in recordings.offered] == [TOPIC, *["/vehicles/vehicle_01/pose"] * 2]
    assert recordings.triggers == recordings.ends == [stage.events()[0]["id"]]
    assert recordings.buffers[TOPIC] is stage.detector.pool.buffers[TOPIC]


def test_a_duplicate_is_neither_recorded_nor_evaluated(stage: DetectorStage) -> None:
    topic = {"name": "/vehicles/{agent}/pose", "storage": "document"}
    reaction = {"rule": "all", "kind": "recording", "recording": "r", "volume": "v", "topics": [topic]}
    stage.apply({**PLAIN, "rules": [{"name": "all", "kind": "always"}], "reactions": [reaction], "topics": [
        {**PLAIN["topics"][0], "name": TOPIC}, PLAIN["topics"][0]]})  # fmt: skip
    message = (pose(NOW, 1.0), NOW)
    stage.live.topics[TOPIC].waiting = [message, message]
    stage.detector.turn()
    assert len(stage.recordings[0].offered) == 1
    assert stage.events() == [], "that everything is recorded is no news"


def test_a_stamp_that_nobody_set_is_the_time_of_reception(stage: DetectorStage) -> None:
    stage.apply(PLAIN)
    stage.live.topics[TOPIC].waiting = [(pose(0, 1.0), NOW + 5)]
    stage.detector.turn()
    assert [sample.stamp for sample in stage.detector.pool.buffers[TOPIC].samples()] == [NOW + 5]


def test_silent_agents_are_stale_and_then_forgotten(stage: DetectorStage) -> None:
    topics = [{**PLAIN["topics"][0], "stale_seconds": 1, "expire_seconds": 5}]
    stage.apply({**PLAIN, "topics": topics})
    stage.live.published = {"/vehicles/vehicle_07/pose": [POSE_TYPE]}
    stage.pass_seconds(1.1)
    stage.send("vehicle-07", 0)
    stage.live.published = {}
    assert stage.status.document()["topics"]["/vehicles/vehicle_07/pose"]["stale"] is False
    stage.pass_seconds(2)
    assert stage.status.document()["topics"]["/vehicles/vehicle_07/pose"]["stale"] is True
    assert 'robotkube_detector_stale_topics{topic="/vehicles/{agent}/pose"} 3' in stage.status.metrics()
    stage.pass_seconds(4)
    assert set(stage.status.document()["topics"]) == {TOPIC, "/vehicles/vehicle_01/pose"}, "who is expected stays"
    assert "/vehicles/vehicle_07/pose" in stage.detector.input_document()["topics"], "counters only grow"


def test_a_latched_topic_goes_with_the_last_of_its_agent(stage: DetectorStage) -> None:
    """It speaks once: its silence says nothing, and recordings of an agent that is there need it."""
    poses = {**PLAIN["topics"][0], "expire_seconds": 5}
    numbers = {"name": "/vehicles/{agent}/static", "type": NUMBER, "durability": "transient_local", "expire_seconds": 5}
    stage.apply({**PLAIN, "topics": [poses, numbers]})
    static = "/vehicles/vehicle_07/static"
    stage.live.published = {"/vehicles/vehicle_07/pose": [POSE_TYPE], static: [NUMBER]}
    stage.pass_seconds(1.1)
    stage.say(static, 7.0)
    stage.live.published = {}
    for _ in range(4):
        stage.pass_seconds(4)
        stage.send("vehicle-07", 0)
    assert len(stage.detector.pool.buffers[static]) == 1
    stage.pass_seconds(6)
    assert set(stage.status.document()["topics"]) == {TOPIC, "/vehicles/vehicle_01/pose"}


# quality of service ---------------------------------------------------------------------------------------------------

STRONG = QosProfile("reliable", "transient_local", 100 * MS, "manual_by_topic", 200 * MS)
WEAK = QosProfile("best_effort", "volatile")


@pytest.mark.parametrize(
    ("asked", "offers", "expected"),
    [
        (RequestedQos(), [], QosProfile()),
        (RequestedQos(), [STRONG], STRONG),
        (RequestedQos(), [STRONG, STRONG._replace(deadline_ns=300 * MS, lease_ns=MS)],
            STRONG._replace(deadline_ns=300 * MS)),
        (RequestedQos(), [STRONG, QosProfile("reliable", "transient_local")],
            QosProfile("reliable", "transient_local")),
        (RequestedQos(durability="volatile", liveliness="automatic", deadline_ns=9, lease_ns=8), [STRONG],
            QosProfile(deadline_ns=9, lease_ns=8)),
        (RequestedQos(), [STRONG, WEAK], QosProfile("best_effort", "volatile")),
        (RequestedQos("reliable", "transient_local"), [WEAK], QosProfile("reliable", "transient_local")),
        (RequestedQos(deadline_ns=5, liveliness="manual_by_topic", lease_ns=6), [], QosProfile(deadline_ns=5,
            liveliness="manual_by_topic", lease_ns=6)),
    ],
)  # fmt: skip
def test_a_subscription_asks_for_what_all_publishers_give(
    asked: RequestedQos, offers: list[QosProfile], expected: QosProfile
) -> None:
    assert matching_profile(asked, [PublisherOffer("/p", POSE_TYPE, offer) for offer in offers]) == expected


@pytest.mark.parametrize(
    ("wanted", "offered", "expected"),
    [
        (QosProfile(), STRONG, ""),
        (QosProfile(), WEAK, "reliability: asked reliable, offered best_effort"),
        (QosProfile(durability="transient_local"), QosProfile(), "durability: asked transient_local, offered volatile"),
        (QosProfile(deadline_ns=50 * MS), STRONG, "deadline: asked 0.05 s, offered 0.1 s"),
        (QosProfile(deadline_ns=100 * MS), STRONG, ""),
        (QosProfile(deadline_ns=50 * MS), QosProfile(), "deadline: asked 0.05 s, offered endless"),
        (
            QosProfile(liveliness="manual_by_topic"),
            QosProfile(),
            "liveliness: asked manual_by_topic, offered automatic",
        ),
        (QosProfile(lease_ns=50 * MS), STRONG, "liveliness lease: asked 0.05 s, offered 0.2 s"),
    ],
)
def test_a_mismatch_names_both_sides(wanted: QosProfile, offered: QosProfile, expected: str) -> None:
    problem = mismatch(POSE_TYPE, wanted, PublisherOffer("/p", POSE_TYPE, offered))
    assert problem == (f"/p does not fit: {expected}" if expected else "")


def test_another_type_is_a_mismatch() -> None:
    assert "type: asked a/msg/B, offered " in mismatch(
        "a/msg/B", QosProfile(), PublisherOffer("", NUMBER, QosProfile())
    )


def test_what_publishers_give_is_asked_for_and_a_flash_of_one_is_not_followed(stage: DetectorStage) -> None:
    def quality() -> QosProfile:
        return stage.live.topics[TOPIC].qos

    stage.apply(PLAIN)
    stage.send("vehicle-00", 0)
    strong, weak = PublisherOffer("/a", POSE_TYPE, STRONG), PublisherOffer("/b", POSE_TYPE, WEAK)
    stage.live.offered[TOPIC] = [strong, PublisherOffer("/c", NUMBER, WEAK)]
    stage.pass_seconds(1.1)
    assert quality() == STRONG, "the first ones, at once; those of another type do not count"
    stage.live.offered[TOPIC] = [strong, weak]
    stage.pass_seconds(1.1)
    assert quality() == WEAK, "who does not fit, at once"
    stage.live.offered[TOPIC] = []
    stage.pass_seconds(2.2)
    stage.live.offered[TOPIC] = [weak]
    stage.pass_seconds(1.1)
    before = stage.live.topics[TOPIC]
    stage.live.offered[TOPIC] = [strong]
    stage.pass_seconds(1.1)
    assert stage.live.topics[TOPIC] is before, "more is asked for when it lasts"
    stage.pass_seconds(1.1)
    assert quality() == STRONG
    assert stage.detector.pool.snapshot()[TOPIC]["messages"] == 1, "the buffer stays"
    assert stage.status.document()["topics"][TOPIC]["problem"].startswith("/a does not fit") is False


def test_broken_promises_are_counted_on_over_a_new_subscription(stage: DetectorStage) -> None:
    def shown() -> tuple[int, int]:
        shown = stage.status.document()["topics"][TOPIC]
        return shown["missed_deadlines"], shown["lost_liveliness"]

    stage.apply({**PLAIN, "topics": [{**PLAIN["topics"][0], "deadline_seconds": 1}]})
    stage.live.topics[TOPIC].violations = QosViolations(3, 1)
    stage.pass_seconds(1.1)
    assert shown() == (3, 1)
    stage.apply({**PLAIN, "topics": [{**PLAIN["topics"][0], "deadline_seconds": 2}]})
    stage.live.topics[TOPIC].violations = QosViolations(1, 0)
    stage.pass_seconds(1.1)
    assert shown() == (4, 1)
    label = '{topic="/vehicles/{agent}/pose"}'
    assert f"robotkube_detector_missed_deadlines_total{label} 4" in stage.status.metrics()
    assert f"robotkube_detector_lost_liveliness_total{label} 1" in stage.status.metrics()


def test_a_misfit_is_told_until_it_is_mended(stage: DetectorStage, caplog: pytest.LogCaptureFixture) -> None:
    """By comparison in /status and the gauge, by the middleware's own count in the counter, by both in the log."""
    caplog.set_level("INFO")

    def shown() -> tuple[str, dict[str, Any]]:
        shown = stage.status.document()["topics"][TOPIC]
        return shown["problem"], shown["incompatible"]

    stage.apply({**PLAIN, "topics": [{**PLAIN["topics"][0], "durability": "transient_local"}]})
    stage.live.offered[TOPIC] = [PublisherOffer("/player", POSE_TYPE, QosProfile())]
    stage.live.topics[TOPIC].incompatible = IncompatiblePublishers(1, "durability")
    stage.pass_seconds(1.1)
    sentence = "/player does not fit: durability: asked transient_local, offered volatile"
    assert shown() == (sentence, {"count": 1, "policy": "durability"})
    assert f"topic {TOPIC}: {sentence}" in caplog.messages
    assert (
        f"topic {TOPIC}: the middleware has refused publishers because of durability (1 so far): asked reliable, "
        "transient_local, offered reliable, volatile"
    ) in caplog.messages
    label = '{topic="/vehicles/{agent}/pose"}'
    assert f"robotkube_detector_incompatible_total{label} 1" in stage.status.metrics()
    assert f"robotkube_detector_mismatched_topics{label} 1" in stage.status.metrics()
    stage.live.offered[TOPIC] = [PublisherOffer("/player", POSE_TYPE, QosProfile(durability="transient_local"))]
    stage.pass_seconds(1.1)
    assert shown() == ("", {"count": 1, "policy": "durability"})
    assert f"topic {TOPIC}: every publisher fits: asked reliable, transient_local" in caplog.messages
    assert f"robotkube_detector_mismatched_topics{label} 0" in stage.status.metrics()
    assert f"robotkube_detector_incompatible_total{label} 1" in stage.status.metrics()
    stage.apply({**PLAIN, "topics": [{**PLAIN["topics"][0], "durability": "volatile"}]})
    stage.live.topics[TOPIC].incompatible = IncompatiblePublishers(2, "reliability")
    stage.live.offered[TOPIC] = []
    stage.pass_seconds(1.1)
    assert shown() == ("", {"count": 3, "policy": "reliability"})
    assert "because of reliability (3 so far): asked reliable, volatile, offered not known any more" in caplog.text


def test_a_weak_publisher_is_subscribed_to_anew_unless_the_settings_insist(stage: DetectorStage) -> None:
    stage.apply(PLAIN)
    stage.send("vehicle-00", 0)
    first = stage.live.topics[TOPIC]
    stage.live.offered[TOPIC] = [PublisherOffer("/player", POSE_TYPE, WEAK)]
    stage.pass_seconds(1.1)
    assert first.closed
    assert stage.live.topics[TOPIC].qos == WEAK
    assert stage.detector.pool.snapshot()[TOPIC]["messages"] == 1, "the buffer stays"
    stage.apply({**PLAIN, "topics": [{**PLAIN["topics"][0], "reliability": "reliable"}]})
    stage.pass_seconds(1.1)
    shown = stage.status.document()["topics"][TOPIC]
    assert shown["asked"] == "reliable, volatile"
    assert shown["offered"] == [{"node": "/player", "quality": "best_effort, volatile"}]
    assert shown["problem"] == "/player does not fit: reliability: asked reliable, offered best_effort"
    assert 'robotkube_detector_mismatched_topics{topic="/vehicles/{agent}/pose"} 1' in stage.status.metrics()


# buffers that a bag fills ---------------------------------------------------------------------------------------------

FOUND = "/vehicles/vehicle_07/pose"


def bag(*seconds: int, topic: str = FOUND, type_name: str = POSE_TYPE) -> list[tuple[str, str, int, bytes]]:
    moments = [NOW + second * SECOND for second in seconds]
    return [(topic, type_name, moment, pose(moment, 1.0)) for moment in moments]


def test_a_bag_fills_buffers_of_topics_that_only_a_pattern_names(stage: DetectorStage) -> None:
    """They are subscribed to as if they had been found, and forgotten when nobody ever sends there."""
    topics = [{**PLAIN["topics"][0], "stale_seconds": 1, "expire_seconds": 5}]
    stage.apply({**PLAIN, "topics": topics})
    assert stage.detector.fill(bag(-3, -2, -1, -1)) == 3, "one of them twice"
    assert stage.detector.fill(bag(-1, topic="/other") + bag(-1, type_name=NUMBER)) == 0
    stage.pass_seconds(1.1)
    stage.send("vehicle-07", 2.0)
    assert len(stage.detector.pool.buffers[FOUND]) == 4
    stage.pass_seconds(6)
    assert FOUND not in stage.detector.pool.buffers


def test_a_bag_fills_the_buffers_of_a_detector_that_rests(stage: DetectorStage) -> None:
    stage.apply({**PLAIN, "state": "inactive"})
    assert stage.detector.fill(bag(-2, -1) + bag(-2, -1, topic=TOPIC)) == 4
    assert stage.live.topics == {}, "it is subscribed to nothing"
    stage.detector.change_state("active")
    stage.detector.turn()
    assert {FOUND, TOPIC} <= set(stage.live.topics)
    assert [len(stage.detector.pool.buffers[name]) for name in (FOUND, TOPIC)] == [2, 2]


def test_who_has_gone_while_the_detector_rested_is_forgotten(stage: DetectorStage) -> None:
    topics = [{**PLAIN["topics"][0], "stale_seconds": 1, "expire_seconds": 5}]
    stage.apply({**PLAIN, "topics": topics})
    stage.live.published = {FOUND: [POSE_TYPE]}
    stage.pass_seconds(1.1)
    stage.send("vehicle-07", 0)
    stage.detector.change_state("inactive")
    stage.live.published = {}
    stage.pass_seconds(60)
    stage.detector.change_state("active")
    stage.pass_seconds(1.1)
    assert len(stage.detector.pool.buffers[FOUND]) == 1, "it may only have been silent"
    stage.pass_seconds(6)
    assert FOUND not in stage.detector.pool.buffers
