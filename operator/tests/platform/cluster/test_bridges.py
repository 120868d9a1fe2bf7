"""Changed topics do not restart a bridge and cost no message on the topics that stay, over a whole run of the story."""

from __future__ import annotations

import json

import pytest

from scenarios.definition import pose_topic
from scenarios.runner.inputs import Plan
from scenarios.runner.observing import collecting, storage
from tests.stages.platform.running_platform import Platform
from tests.stages.platform.story import BRIDGE, Story


@pytest.fixture(scope="module")
def plans(platform: Platform, story: Story) -> tuple[Plan, ...]:
    """Plans that this run's event led to."""
    events = {entry["event"] for entry in story.report["audit"] if entry["event"]}
    return tuple(
        plan for plan in collecting.plans(platform.access, collecting.Collecting(print)) if events & set(plan.events)
    )


def test_the_plans_changed_all_bridges_concerned(plans: tuple[Plan, ...]) -> None:
    bridges = {f"{agent}/{BRIDGE}" for agent in ("cloud-0", "vehicle-00", "vehicle-01")}
    assert [bridges <= set(plan.changed) for plan in plans] == [True, True]


def test_every_bridge_stayed_the_same_pod_without_a_restart(platform: Platform, story: Story) -> None:
    seen = {}
    for pod in story.of(BRIDGE):
        seen.setdefault(pod["metadata"]["namespace"], []).append(pod)
    assert set(seen) >= set(platform.agents)
    assert {agent: len(pods) for agent, pods in seen.items()} == dict.fromkeys(seen, 1)
    restarts = [status["restartCount"] for pods in seen.values() for status in pods[0]["status"]["containerStatuses"]]
    assert set(restarts) == {0}


def test_no_pose_was_lost_while_topics_changed(platform: Platform, story: Story) -> None:
    """Ledgers of all players against what arrived at the cloud's detector, one bridge and the broker further: every
    message of the run, over the deployment and the withdrawal."""
    for agent in platform.scenario.vehicles:
        topic = pose_topic(agent)
        file = platform.provider.volume_path(agent, "bags") / collecting.ledger_file(story.report["run"], topic)
        played = len(storage.ledger(json.loads(line) for line in file.read_text().splitlines()))
        assert played >= 1000
        assert received(story, topic) == played, topic


def received(story: Story, topic: str) -> int:
    """Poses of a topic that reached the detector during the run."""
    before = 0
    if story.before and story.before.started == story.after.started and topic in story.before.topics:
        before = story.before.topics[topic].received
    return story.after.topics[topic].received - before
