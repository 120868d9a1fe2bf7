"""The detector's document: what is read, and one clear problem per mistake."""

from __future__ import annotations

from typing import Any

import pytest

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.robots.detector.core.settings import SettingsContext, read_detector_settings
from robotkube.robots.reactions.core.settings import OperatorReactionSettings, RecordingReactionSettings, RecordingTopic
from robotkube.robots.ros.core.topic_patterns import TopicPattern
from robotkube.robots.rules.core import Proximity

GOOD = """
name: cloud-0/event-detector
topics:
- {name: "/vehicles/{agent}/pose", type: geometry_msgs/msg/PoseStamped, buffer: {seconds: 5}}
- {name: /vehicles/vehicle_00/cloud, type: sensor_msgs/msg/PointCloud2, depth: 20}
rules:
- name: near
  kind: proximity
  agents: [a, b]
  topic: "/vehicles/{agent}/pose"
  start_distance_m: 400
  stop_distance_m: 500
- {name: all, kind: always}
reactions:
- {rule: near, kind: operator, application: recording, parameters: {vehicles: "{agents}"}}
- rule: all
  kind: recording
  recording: task-1
  afterSeconds: 1.5
  trace: ab
  topics: [{name: /vehicles/vehicle_00/cloud, storage: segment}]
  volume: recordings
- {rule: near, kind: webhook, url: "https://example.org:8443/hook?x=1", secret: ops}
- {rule: near, kind: mqtt, topic: events/near, retained: true}
- {rule: near, kind: python, plugin: whisper, settings: {to: me}}
"""


def document() -> dict[str, Any]:
    return read_mapping(GOOD, "config.yaml")


def test_a_good_document_is_read() -> None:
    settings = read_detector_settings(document(), "config.yaml")
    near = settings.rules[0]
    (operator, recording, *others) = settings.reactions
    assert isinstance(near.condition, Proximity)
    assert (near.condition.start_distance_m, near.condition.stop_distance_m, near.agents) == (400, 500, ("a", "b"))
    assert isinstance(operator, OperatorReactionSettings)
    assert operator.parameters == {"vehicles": "{agents}"}
    assert isinstance(recording, RecordingReactionSettings)
    assert recording.topics == (RecordingTopic(TopicPattern("/vehicles/vehicle_00/cloud"), "segment", 0, 0),)
    assert recording.after_seconds == 1.5
    assert (settings.topics[0].buffer_seconds, settings.topics[1].depth) == (5, 20)
    assert settings.deliveries == tuple(others)
    assert [delivery.name for delivery in settings.deliveries] == [
        "webhook near example.org", "mqtt near events/near", "python near whisper",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("path", "value", "expected"),
    [
        (["name"], None, "name: is missing; it must be a text that is not empty"),
        (["topics"], [], "topics: must be a list of 1 to 200 mappings"),
        (["topics", 0, "typ"], 1, "topics[0].typ: unknown key; known are"),
        (["topics", 0, "name"], "pose", "topics[0].name: pose is not a full ROS topic name"),
        (["topics", 0, "name"], "/{agent}/{agent}", "more than once"),
        (["topics", 0, "depth"], 0, "topics[0].depth: must be a whole number from 1 to 100000"),
        (["topics", 0, "depth"], True, "topics[0].depth: must be a whole number"),
        (["topics", 0, "source"], "dds", "topics[0].source: must be one of ros, mqtt"),
        (["topics", 0, "deadline_seconds"], 0, "topics[0].deadline_seconds: must be a number from 0.001"),
        (
            ["topics", 0, "type"],
            "std_msgs/Float64",
            "topics[0].type: 'std_msgs/Float64' is not written like geometry_msgs/msg/",
        ),
        (["topics", 0, "expire_seconds"], 2, "topics[0].expire_seconds: must not be less than stale_seconds"),
        (["topics", 0, "buffer", "jump"], "back", "topics[0].buffer.jump: must be one of restart, keep"),
        (["buffer"], {"bytes": 5}, "buffer.bytes: must be a whole number from 1000000"),
        (["state"], "asleep", "state: must be one of active, buffering, inactive"),
        (["topics", 0, "durability"], "latched", "must be one of volatile, transient_local"),
        (["topics", 0, "buffer"], 5, "topics[0].buffer: must be a mapping"),
        (["topics", 1, "name"], "/vehicles/{agent}/pose", "topics: /vehicles/{agent}/pose stands twice"),
        (["rules", 0, "kind"], "nearness", "rules[0].kind: must be one of proximity, geofence"),
        (["rules", 0, "agents"], ["a"], "rules[0].agents: must be a list of at least 2 different texts"),
        (["rules", 0, "agents"], ["a", "a"], "rules[0].agents: must be a list of at least 2 different texts"),
        (["rules", 0, "stop_distance_m"], 399, "rules[0].stop_distance_m: must not be less than start_distance_m"),
        (["rules", 0, "topic"], "/vehicles/vehicle_00/pose", "must hold {agent}"),
        (["rules", 0, "topic"], "/v/{agent}/pose", "is not listed under topics"),
        (["rules", 1, "name"], "near", "near is the name of another rule, too"),
        (["rules", 1, "name"], "time-jump", "rules: the name time-jump is taken"),
        (["reactions", 0, "rule"], "far", "reactions[0].rule: there is no rule far; name one of all, near, time-jump"),
        (["reactions", 0, "lease_seconds"], 4, "reactions[0].lease_seconds: must be a whole number from 5 to 86400"),
        (["task"], "alone", "task: 'alone' must be <namespace>/<name>"),
        (["reactions", 1, "topics", 0, "before_seconds"], 11, "has before_seconds 11, its buffer 10 s; make buffer"),
        (["reactions", 2, "url"], "ftp://x/", "reactions[2].url: must be an address such as https://"),
        (["reactions", 2, "url"], "http://me:secret@x/", "reactions[2].url: must be an address"),
        (["reactions", 2, "url"], "http://x:65536/", "reactions[2].url: must have a port from 1 to 65535, not 65536"),
        (["reactions", 2, "url"], "http://a..b/", "reactions[2].url: a..b is no host"),
        (["reactions", 2, "url"], f"http://{'a' * 64}.org/", "is no host: a name of labels of at most 63 letters"),
        (["reactions", 2, "url"], "http://[:::]/", "reactions[2].url: [:::] is no host"),
        (["reactions", 2, "url"], "http://10.0.0.256/", "reactions[2].url: 10.0.0.256 is no host"),
        (["rules", 0, "silent"], True, "reactions[0].rule: near is silent and gives no events; take silent away"),
        (["reactions", 2, "secret"], "not a key", "reactions[2].secret: must be the name of a key"),
        (["reactions", 3, "topic"], "a/+/b", "reactions[3].topic: must be the full name of an MQTT topic"),
        (["reactions", 4, "plugin"], "shout", "reactions[4].plugin: no installed package offers the reaction shout"),
        (["reactions", 4, "url"], "http://x", "reactions[4].url: unknown key; known are"),
        (["reactions", 1, "recording"], "../x", "reactions[1].recording: must be a name"),
        (["reactions", 1, "topics", 0, "storage"], "file", "must be one of document, segment"),
        (["reactions", 1, "topics", 0, "name"], "/other", "reactions[1].topics: /other is not listed under topics"),
    ],
)
def test_each_mistake_is_named(path: list[Any], value: Any, expected: str) -> None:
    bad: Any = document()
    target = bad
    for key in path[:-1]:
        target = target[key]
    if value is None:
        del target[path[-1]]
    else:
        target[path[-1]] = value
    with pytest.raises(DocumentError) as caught:
        read_detector_settings(bad, "config.yaml", SettingsContext(reactions=["whisper"]))
    assert expected in str(caught.value)
    assert str(caught.value).startswith("config.yaml: ")


def test_a_type_that_this_image_does_not_know_is_refused_in_ros_and_learned_at_the_broker() -> None:
    def missing(name: str) -> str:
        return "" if name.startswith(("geometry_msgs/", "sensor_msgs/")) else f"type {name}: is not here"

    own: Any = document()
    own["topics"].append({"name": "/a", "type": "rover_msgs/msg/Fix"})
    own["topics"].append({"name": "/b", "type": "rover_msgs/msg/Fix", "source": "mqtt"})
    context = SettingsContext(reactions=["whisper"], missing_type=missing)
    with pytest.raises(DocumentError) as caught:
        read_detector_settings(own, "config.yaml", context)
    (problem,) = caught.value.problems
    assert problem.startswith("topics[2].type: type rover_msgs/msg/Fix: is not here; take another type, an image that")
    read_detector_settings(document(), "config.yaml", context)


def test_all_mistakes_are_named_at_once() -> None:
    with pytest.raises(DocumentError) as caught:
        read_detector_settings({"name": "", "topics": [{"name": 1}], "extra": 0}, "config.yaml")
    assert len(caught.value.problems) >= 4


@pytest.mark.parametrize("url", ["http://[::1]:8080/x", "http://10.0.0.255", "https://a-b.svc.cluster.local.:65535/"])
def test_addresses_of_all_sorts_are_taken(url: str) -> None:
    good: Any = document()
    good["reactions"][2]["url"] = url
    read_detector_settings(good, "config.yaml", SettingsContext(reactions=["whisper"]))


def test_a_number_that_json_has_not_is_named_with_the_rest() -> None:
    bad: Any = document()
    bad["rules"][0]["start_distance_m"] = float("nan")
    bad["reactions"][0]["parameters"] = {"x": float("inf")}
    bad["extra"] = 1
    with pytest.raises(DocumentError) as caught:
        read_detector_settings(bad, "config.yaml", SettingsContext(reactions=["whisper"]))
    keys = [problem.partition(": ")[0] for problem in caught.value.problems]
    assert keys == ["rules[0].start_distance_m", "extra", "reactions[0].parameters.x"]


def test_what_does_not_fit_together_is_named_with_the_rest_and_nothing_twice() -> None:
    bad: Any = document()
    bad["rules"][0]["kind"] = "nearness"
    bad["rules"].append({"name": "both", "kind": "combination", "all": ["near", "nobody"], "agents": ["a", "b"]})
    bad["reactions"][2]["rule"] = "far"
    bad["topics"].append({"name": "pose", "type": "std_msgs/msg/String"})
    with pytest.raises(DocumentError) as caught:
        read_detector_settings(bad, "config.yaml", SettingsContext(reactions=["whisper"]))
    keys = [problem.partition(": ")[0] for problem in caught.value.problems]
    last = f"rules[{len(bad['rules']) - 1}]"
    assert keys == [f"topics[{len(bad['topics']) - 1}].name", "rules[0].kind", f"{last}.all", "reactions[2].rule"]
    assert "there is no rule nobody" in str(caught.value)


@pytest.mark.parametrize(
    ("topic", "agent"),
    [
        ("/vehicles/vehicle_00/pose", "vehicle-00"),
        ("/vehicles/pose", None),
        ("/vehicles//pose", None),
        ("/vehicles/a/b/pose", None),
        ("/vehicles/vehicle_00/pose2", None),
    ],
)
def test_patterns_find_the_agent(topic: str, agent: str | None) -> None:
    assert TopicPattern("/vehicles/{agent}/pose").agent(topic) == agent


def test_patterns_name_the_topic() -> None:
    assert TopicPattern("/vehicles/{agent}/pose").topic("vehicle-07") == "/vehicles/vehicle_07/pose"
    assert TopicPattern("/tf").agent("/tf") == ""
