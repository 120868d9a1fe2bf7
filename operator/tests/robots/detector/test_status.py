"""What a detector says of itself, to whoever reads beside: metrics, status, log."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from robotkube.robots.detector.core.settings import TopicSettings
from robotkube.robots.detector.loops.status import PREFIX
from robotkube.robots.ros.core.qos import IncompatiblePublishers, PublisherOffer, QosProfile
from tests.stages.detector.in_memory import NOW, DetectorStage, MemoryTasks, pose
from tests.stages.detector.proximity_settings import SETTINGS
from tests.stages.detector.rules import NUMBER

POSE = "geometry_msgs/msg/PoseStamped"
QUIET = {**SETTINGS, "reactions": []}


def test_labels_are_patterns_rules_and_reactions_never_agents() -> None:
    stage = DetectorStage(MemoryTasks())
    stage.apply(SETTINGS)
    stage.send("vehicle-00", 0)
    stage.send("vehicle-01", 0)
    stage.close()
    lines = [line for line in stage.status.metrics().splitlines() if not line.startswith("#")]
    assert 'robotkube_detector_received_total{topic="/vehicles/{agent}/pose"} 2' in lines
    assert 'robotkube_detector_active_events{rule="near"} 1' in lines
    assert any(line.startswith('robotkube_detector_reaction_delivered_total{reaction="operator"}') for line in lines)
    assert not any("vehicle" in line.replace("/vehicles/{agent}/pose", "") for line in lines)


def shown(stage: DetectorStage) -> dict[str, int]:
    """The metrics of the vehicles' poses, without prefix."""
    label = '{topic="/vehicles/{agent}/pose"} '
    lines = [line for line in stage.status.metrics().splitlines() if label in line]
    return {line.partition(label)[0].removeprefix(PREFIX): int(line.partition(label)[2]) for line in lines}


def test_counters_never_fall_when_topics_are_forgotten_or_given_up() -> None:
    """What falls is a restart for Prometheus: its rates would count everything twice."""
    stage = DetectorStage(MemoryTasks())
    topic = {**SETTINGS["topics"][0], "expire_seconds": 60, "buffer": {"count": 2}}
    settings = {**SETTINGS, "topics": [topic], "reactions": []}
    stage.apply(settings)
    assert (shown(stage)["received_total"], shown(stage)["subscriptions"]) == (0, 2)
    stage.live.published = {f"/vehicles/vehicle_0{number}/pose": [POSE] for number in range(6)}
    stage.pass_seconds(1.1)
    for number in range(6):
        waiting = stage.live.topics[f"/vehicles/vehicle_0{number}/pose"].waiting
        waiting += [(pose(NOW + step, 1.0), NOW + step) for step in (1, 2, 2, 3)] + [(b"", NOW)]
    stage.detector.turn()
    counted = {"received_total": 24, "malformed_total": 6, "duplicates_total": 6, "evicted_total": 6, "late_total": 0}
    assert counted.items() <= shown(stage).items()
    stage.live.published = {}
    stage.pass_seconds(120)
    assert shown(stage)["subscriptions"] == 2
    assert (counted | {"buffer_messages": 4}).items() <= shown(stage).items()
    stage.detector.change_state("inactive")
    assert (counted | {"subscriptions": 0, "buffer_messages": 4}).items() <= shown(stage).items()
    stage.detector.change_state("active")
    stage.live.published = {"/vehicles/vehicle_05/pose": [POSE]}
    stage.pass_seconds(1.1)
    stage.send("vehicle-05", 1.0)
    assert (counted | {"received_total": 25, "subscriptions": 3}).items() <= shown(stage).items()
    stage.apply({**settings, "topics": [{"name": "/vehicles/{agent}/other", "type": NUMBER}], "rules": []})
    assert shown(stage) == {}
    stage.close()


def test_a_state_is_named_when_it_is_reached() -> None:
    """Whoever reads beside sees none without its subscriptions."""
    stage = DetectorStage(MemoryTasks())
    stage.apply({**QUIET, "state": "inactive"})
    announce = stage.live.announce
    named = list[str]()

    def announcing(topics: Sequence[TopicSettings]) -> None:
        named.append(stage.status.document()["state"])
        announce(topics)

    stage.live.announce = announcing  # type: ignore[method-assign]
    for state in ("buffering", "active", "inactive"):
        stage.detector.change_state(state)
        assert stage.status.document()["state"] == state
    assert named == ["inactive", "buffering", "active"]


def test_a_refusal_is_told_also_when_it_comes_just_before_a_new_subscription(
    caplog: pytest.LogCaptureFixture,
) -> None:
    stage = DetectorStage(MemoryTasks())
    name = "/vehicles/vehicle_00/pose"
    stage.apply(QUIET)
    first = stage.live.topics[name]

    def offers(topic: str) -> Sequence[PublisherOffer]:
        first.incompatible = IncompatiblePublishers(1, "reliability")
        return [PublisherOffer("/player", POSE, QosProfile("best_effort"))] if topic == name else []

    stage.live.offers = offers  # type: ignore[method-assign]
    stage.pass_seconds(1.1)
    assert first.closed
    assert "because of reliability (1 so far): asked reliable, volatile, offered best_effort, volatile" in caplog.text
