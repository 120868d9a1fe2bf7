"""Publishers of ROS topics: one per topic and place, as far as the interfaces of charts say."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from robotkube.delivery.manager.core.composition.composer import Composition, Demand, Inputs, Met, Refused, compose
from robotkube.delivery.manager.core.conflicts import History, resolve
from robotkube.delivery.manager.core.placement.placement import Agent, NodeState, fleet
from robotkube.delivery.tasks.core.task_description import PREEMPT
from robotkube.foundation.documents.adapters.json_schema import validate
from tests.stages.delivery.manager.placement import RENDER, application, catalogue, chart, demand, task

AGENTS = [Agent("vehicle-00", "vehicle", "vehicle-00"), Agent("cloud-0", "cloud", "cloud-0")]
NODES = [NodeState(agent.name, agent.name, agent.role, frozenset(), True) for agent in AGENTS]
QOS = {"reliability": "reliable", "durability": "volatile"}
OBJECTS = "/agents/vehicle_00/objects"
BRIDGE = application(
    {
        "name": "bridge",
        "release": "mqtt-bridge",
        "placement": {"agent": "{{ agent }}"},
        "values": {"bridge": {"out": "{{ topics.out }}", "in": "{{ topics['in'] }}"}},
    },
    name="bridge",
    word="link/mqtt",
)


def publishing(name: str, topic: str = "{{ values.topic }}") -> tuple[str, str]:
    interface = {"name": "said", "medium": "ros", "direction": "out", "topic": topic, "type": "std_msgs/msg/String"}
    return chart(name, interfaces=[{**interface, "qos": QOS}])


def service(name: str, topic: str = OBJECTS, agent: str = "vehicle-00", **more: Any) -> dict[str, Any]:
    asked = {"name": name, "version": ">=0.1.0"}
    place = {"agent": agent}
    return {"name": name, "chart": asked, "release": name, "placement": place, "values": {"topic": topic}, **more}


def link_to(agent: str, topic: str) -> dict[str, Any]:
    carried = {"name": topic, "type": "std_msgs/msg/String", "channel": "telemetry", **QOS, "depth": 10}
    return {"kind": "mqtt", "from": {"medium": "mqtt"}, "to": {"agent": agent}, "topics": [carried]}


CHARTS = (publishing("one"), publishing("other"), BRIDGE)


def composed(first: Mapping[str, Any], second: Mapping[str, Any], *charts: tuple[str, str]) -> Composition:
    """What tasks ops/first and ops/second get, whose applications (`early`, `late`) have these parts."""
    files = [application(*parts["services"], links=parts["links"], name=name) for name, parts in named(first, second)]
    asked = [demand(task("first", application="early")), demand(task("second", application="late"))]
    return compose(asked, Inputs(catalogue(*files, *CHARTS, *charts), fleet(AGENTS, NODES), {}, RENDER, validate))


def named(*parts: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    return list(zip(("early", "late"), ({"services": [], "links": [], **part} for part in parts), strict=True))


def outcome(composition: Composition, key: str = "ops/second") -> Met | Refused:
    assert isinstance(composition.outcomes["ops/first"], Met), composition.outcomes
    return composition.outcomes[key]


def test_a_second_publisher_of_a_topic_on_an_agent_is_refused() -> None:
    refusal = outcome(composed({"services": [service("one")]}, {"services": [service("other")]}))
    assert refusal == Refused(
        "TopicTaken",
        f"release vehicle-00/other of application late would publish topic {OBJECTS} on vehicle-00, where release "
        "vehicle-00/one publishes it for task ops/first (application early): who subscribes would get both mixed; "
        "withdraw that, let the application publish under another name (a parameter in it), or place this one on "
        "another agent",
    )


@pytest.mark.parametrize(
    "other",
    [
        service("other", agent="cloud-0"),
        service("other", "/agents/vehicle_00/tracks"),
        service("one"),
    ],
    ids=["elsewhere", "another topic", "the same release"],
)
def test_another_place_another_topic_and_one_release_for_both_are_no_conflict(other: Mapping[str, Any]) -> None:
    assert isinstance(outcome(composed({"services": [service("one")]}, {"services": [other]})), Met)


def test_what_the_interfaces_do_not_say_is_not_refused() -> None:
    """No interface, a template that gives no topic, and a pattern that stands for one topic per agent."""
    for silent in (
        chart("other"),
        publishing("other", "{{ values.nothing }}"),
        publishing("other", "/agents/{agent}/objects"),
    ):
        composition = composed({"services": [service("one")]}, {"services": [service("other")]}, silent)
        assert isinstance(outcome(composition), Met)


LONGEST = f"/{'x' * 246}"
"""As long as ROS takes it."""


def test_a_topic_as_long_as_ros_takes_it_has_one_publisher() -> None:
    """From 201 characters on, nothing was known of it, and two tasks published on it."""
    for topic in (f"/agents/{'x' * 205}", LONGEST):
        first, second = ({"services": [service(name, topic)]} for name in ("one", "other"))
        refusal = outcome(composed(first, second))
        assert isinstance(refusal, Refused)
        assert refusal.reason == "TopicTaken"


def test_a_type_that_nothing_is_known_of_does_not_hide_who_publishes() -> None:
    wrong = {"name": "said", "medium": "ros", "direction": "out", "topic": "{{ values.topic }}"}
    silent = chart("other", interfaces=[{**wrong, "type": "{{ values.nothing }}", "qos": QOS}])
    refusal = outcome(composed({"services": [service("one")]}, {"services": [service("other")]}, silent))
    assert isinstance(refusal, Refused)
    assert refusal.reason == "TopicTaken"


@pytest.mark.parametrize("direction", ["in", "out"])
def test_a_topic_that_is_too_long_for_ros_is_refused(direction: str) -> None:
    interface = {"name": "said", "medium": "ros", "direction": direction, "topic": "{{ values.topic }}"}
    long = chart("other", interfaces=[{**interface, "type": "std_msgs/msg/String", "qos": QOS}])
    asked = composed({"services": [service("one")]}, {"services": [service("other", f"{LONGEST}x")]}, long)
    assert outcome(asked) == Refused(
        "CompositionFailed",
        f"topic /{'x' * 59}... of interface said of chart other has 248 characters, and ROS takes 247; give it a "
        "shorter name",
    )


def test_a_link_that_is_too_long_for_ros_is_refused() -> None:
    refusal = outcome(composed({}, {"links": [link_to("vehicle-00", f"/agents/vehicle_00/{'x' * 230}")]}))
    assert isinstance(refusal, Refused)
    assert "of a link has 249 characters, and ROS takes 247" in refusal.message


@pytest.mark.parametrize("topic", ["/tf", "/tf_static", "/diagnostics"])
def test_topics_that_ros_shares_may_have_many_publishers(topic: str) -> None:
    first, second = ({"services": [service(name, topic)]} for name in ("one", "other"))
    assert isinstance(outcome(composed(first, second)), Met)


def test_a_bridge_publishes_what_it_brings_in() -> None:
    brings, says = {"links": [link_to("vehicle-00", OBJECTS)]}, {"services": [service("other")]}
    refusal = outcome(composed(brings, says))
    assert isinstance(refusal, Refused)
    assert refusal.reason == "TopicTaken"
    assert "where the mqtt bridge of vehicle-00 publishes it for task ops/first (application early)" in refusal.message
    refusal = outcome(composed(says, brings))
    assert isinstance(refusal, Refused)
    assert f"the mqtt bridge of vehicle-00 of application late would publish topic {OBJECTS}" in refusal.message
    assert isinstance(outcome(composed(brings, brings)), Met)


def test_an_application_with_two_publishers_of_a_topic_cannot_be_composed() -> None:
    """No other demand causes that, so none is waited for."""
    refusal = outcome(composed({}, {"services": [service("one"), service("other")]}))
    assert refusal == Refused(
        "CompositionFailed",
        f"topic {OBJECTS} on vehicle-00 has two publishers in application late, release vehicle-00/one and release "
        "vehicle-00/other: who subscribes would get both mixed; give each of them a topic of its own",
    )


def test_who_may_preempt_gets_the_topic() -> None:
    files = [application(service(name), name=f"app-{name}") for name in ("one", "other")]
    inputs = Inputs(catalogue(*files, *CHARTS), fleet(AGENTS, NODES), {}, RENDER, validate)
    low = demand(task("low", application="app-one"))
    high = demand(task("high", application="app-other", priority=500, conflict_policy=PREEMPT))

    def composed_with(demands: Any) -> Composition:
        asked: list[Demand] = list(demands)
        return compose(asked, inputs)

    resolution = resolve([low, high], composed_with, History(answered=frozenset({"ops/low"})), 0)
    assert isinstance(resolution.outcomes["ops/high"], Met)
    assert resolution.outcomes["ops/low"] == Refused("Preempted", "gave way to ops/high of priority 500")
