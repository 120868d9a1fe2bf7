"""Settings of a bridge and the difference between two of them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.errors import DocumentError
from robotkube.robots.bridge.core.settings import (
    GATEWAY_TOPICS,
    GATEWAY_TYPE,
    BridgedTopic,
    check_agent,
    difference,
    read_bridge_settings,
)

POSE = {"name": "/vehicles/vehicle_00/pose", "type": "geometry_msgs/msg/PoseStamped"}
TOPICS = st.dictionaries(st.sampled_from(["/a", "/b", "/c", "/d"]), st.sampled_from([1, 2]), max_size=4).map(
    lambda depths: {name: BridgedTopic(name, "x/msg/Y", depth=depth) for name, depth in depths.items()}
)


def test_defaults_are_those_of_a_pose() -> None:
    settings = read_bridge_settings({"agent": "vehicle-00", "out": [POSE]}, "config.yaml")
    topic = settings.outgoing["/vehicles/vehicle_00/pose"]
    assert (topic.channel, topic.reliability, topic.durability, topic.depth) == (
        "telemetry",
        "reliable",
        "volatile",
        1000,
    )
    assert topic.mqtt == "mqtt/vehicles/vehicle_00/pose"
    assert settings.channels == {"telemetry"}


def test_each_kind_of_traffic_has_a_connection() -> None:
    topics = [{**POSE, "name": f"/{kind}", "channel": kind, "deadline_seconds": 1} for kind in ("safety", "bulk")]
    settings = read_bridge_settings({"agent": "vehicle-00", "out": topics}, "config.yaml")
    assert settings.channels == {"safety", "telemetry", "bulk"}
    assert {topic.deadline_seconds for topic in settings.outgoing.values()} == {1.0}


def test_topics_of_the_task_gateway_have_names_of_their_own_per_agent() -> None:
    topics = {way: [{"name": name, "type": GATEWAY_TYPE}] for name, way in GATEWAY_TOPICS.items()}
    settings = read_bridge_settings({"agent": "vehicle-00", **topics}, "config.yaml")
    assert settings.outgoing["/robotkube/tasks"].mqtt == "robotkube/tasks/vehicle-00"
    assert settings.incoming["/robotkube/task_status"].mqtt == "robotkube/task_status/vehicle-00"


TASKS = {"name": "/robotkube/tasks", "type": GATEWAY_TYPE}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"in": [TASKS]}, r"in\[0\]: /robotkube/tasks goes only out; move it there"),
        ({"out": [{**TASKS, "type": "x/msg/Y"}]}, r"out\[0\].type: 'x/msg/Y' must be 'std_msgs/msg/String'"),
        ({"out": [{**TASKS, "durability": "transient_local"}]}, r"out\[0\].durability: .* must be 'volatile'"),
        ({"out": [{**POSE, "speed": 1}]}, r"out\[0\].speed: unknown key"),
        ({"out": [{"name": POSE["name"]}]}, r"out\[0\].type: missing"),
        ({"out": [{**POSE, "channel": "fast"}]}, r"out\[0\].channel: 'fast'"),
        ({"out": [{**POSE, "deadline_seconds": 0}]}, r"out\[0\].deadline_seconds: 0 must be .* from 0.05 to 10"),
        ({"out": [{**POSE, "deadline_seconds": 10.5}]}, r"out\[0\].deadline_seconds: 10.5 must be a number of seconds"),
        ({"out": [{**POSE, "deadline_seconds": True}]}, r"out\[0\].deadline_seconds: True"),
        ({"out": [{**POSE, "deadline_seconds": "1"}]}, r"out\[0\].deadline_seconds: '1'"),
        ({"out": [{**POSE, "depth": 0}]}, r"out\[0\].depth: 0 must be a number of messages from 1"),
        ({"out": [{**POSE, "depth": True}]}, r"out\[0\].depth: True"),
        ({"out": [{**POSE, "name": "vehicles/pose"}]}, r"out\[0\].name: 'vehicles/pose' must match"),
        ({"out": [POSE, POSE]}, r"out\[1\].name: .* stands twice"),
        ({"out": [POSE], "in": [POSE]}, "would go round in circles"),
        ({"out": {}}, "out: must be a list"),
        ({"agent": "Vehicle_00"}, "agent: 'Vehicle_00' must match"),
        ({"outgoing": []}, "outgoing: unknown key"),
    ],
)
def test_refusals_name_file_key_and_fix(change: dict[str, object], words: str) -> None:
    with pytest.raises(DocumentError, match=words) as caught:
        read_bridge_settings({"agent": "vehicle-00", **change}, "ConfigMap vehicle-00/mqtt-bridge")
    assert str(caught.value).startswith("ConfigMap vehicle-00/mqtt-bridge: ")


@given(TOPICS, TOPICS)
def test_the_difference_turns_old_into_new_and_touches_nothing_else(
    old: dict[str, BridgedTopic], new: dict[str, BridgedTopic]
) -> None:
    change = difference(old, new)
    kept = {name: topic for name, topic in old.items() if name not in change.closed}
    assert {**kept, **{topic.name: topic for topic in change.opened}} == new
    assert all(old.get(topic.name) != topic for topic in change.opened)
    assert all(new.get(name) != old[name] for name in change.closed)


def test_the_agent_stays() -> None:
    old = read_bridge_settings({"agent": "vehicle-00"}, "f")
    check_agent(None, old, "f")
    check_agent(old, old, "f")
    with pytest.raises(DocumentError, match="agent: cannot change from vehicle-00 to vehicle-01"):
        check_agent(old, read_bridge_settings({"agent": "vehicle-01"}, "f"), "f")
