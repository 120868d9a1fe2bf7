"""From an entry's interfaces to the topics they give, and from what was seen to words about it."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.errors import DocumentError
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.registry.catalogue.core.expected_topics import (
    COMMON_TOPICS,
    TOPICS_MAX,
    ExpectedTopic,
    declaration_checks,
    expected_topics,
    outputs_of,
)
from robotkube.registry.charts.core.values_schemas import overlay
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.suites.core.interface_observations import (
    CHECKS_MAX,
    InputResponse,
    Observation,
    ObservedPublication,
    Subscription,
    bounded,
    compare,
    read_observation,
    with_broker_log,
)
from robotkube.robots.ros.core.graph import Endpoint

POSE, STRING = "geometry_msgs/msg/PoseStamped", "std_msgs/msg/String"
QUALITY = {"reliability": "reliable", "durability": "volatile"}
INPUT = {"name": "input", "medium": "ros", "direction": "in", "topic": "/in", "type": STRING, "qos": QUALITY}
OUTPUT = {**INPUT, "name": "output", "direction": "out", "topic": "/out"}
FRAME = {"name": "frame", "medium": "mqtt", "direction": "out", "topic": "state", "qos": {"qos": 1, "retain": False}}
STORED = {"name": "stored", "medium": "database", "direction": "out", "topic": "samples"}

render = Jinja2Templates().render


def expected(*interfaces: Any, **values: Any) -> tuple[ExpectedTopic, ...]:
    return expected_topics(interfaces, values, render)


def problems(*interfaces: Any, **values: Any) -> str:
    with pytest.raises(DocumentError) as caught:
        expected(*interfaces, **values)
    return str(caught.value)


def failed(topics: tuple[ExpectedTopic, ...], seen: Observation) -> dict[str, str]:
    return {check.name: f"{check.found} -> {check.fix}" for check in compare("s", topics, seen) if not check.passed}


def end(topic: ExpectedTopic, /, **other: Any) -> Endpoint:
    made = Endpoint(topic.example, topic.direction, topic.type, topic.reliability, topic.durability, "/node")
    return replace(made, **other)


# --- what an entry gives ---------------------------------------------------------------------------------------------


def test_values_are_merged_as_helm_merges_them() -> None:
    defaults = {"a": {"b": 1, "c": 2}, "list": [1], "gone": 1, "kept": 0}
    assert overlay(defaults, {"a": {"c": 3}, "list": [], "gone": None}) == {
        "a": {"b": 1, "c": 3},
        "list": [],
        "kept": 0,
    }
    assert defaults["a"] == {"b": 1, "c": 2}


def test_an_interface_stands_once_per_element_with_everything_of_it() -> None:
    loop = {
        **OUTPUT,
        "forEach": {"topic": "{{ values.out }}"},
        "topic": "/x{{ topic.name }}",
        "type": "{{ topic.type }}",
        "qos": {"reliability": "{{ topic.reliability | default('reliable') }}", "durability": "volatile"},
    }
    out = [{"name": "/a", "type": POSE}, {"name": "/b", "type": STRING, "reliability": "best_effort"}]
    interfaces = expected(loop, out=out)
    assert [(t.topic, t.type, t.reliability) for t in interfaces] == [
        ("/x/a", POSE, "reliable"),
        ("/x/b", STRING, "best_effort"),
    ]
    assert expected(loop, out=[]) == ()


def test_a_pattern_stands_for_one_level() -> None:
    (topic,) = expected({**INPUT, "topic": "/vehicles/{agent}/pose"})
    assert topic.example == "/vehicles/suite_agent/pose"
    assert topic.matches("/vehicles/vehicle_00/pose")
    assert not topic.matches("/vehicles/a/b/pose")
    assert not topic.matches("/vehicles//pose")
    (filtered,) = expected({**FRAME, "topic": "state/{agent}"})
    assert filtered.matches("state/+")
    assert not filtered.matches("state/#")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"topic": "pose"}, "topic 'pose': is not a ROS topic such as /vehicles/vehicle_00/pose"),
        ({"topic": "/vehicle-00/pose"}, "is not a ROS topic"),
        ({"topic": "{{ values.none }}"}, "interface output: template '{{ values.none }}': 'dict object' has no"),
        ({"type": "{{ values.kind }}"}, "type 'pose' is not written like geometry_msgs/msg/PoseStamped"),
        (
            {"qos": {**QUALITY, "reliability": "{{ values.kind }}"}},
            "qos.reliability is 'pose' and must be one of reliable",
        ),
        (
            {"medium": "mqtt", "qos": {"qos": "{{ values.kind }}", "retain": False}},
            "qos.qos is 'pose' and must be one of 0, 1, 2",
        ),
        ({"medium": "mqtt", "qos": {"qos": True, "retain": False}}, "qos.qos is True and must be one of 0, 1, 2"),
        ({"medium": "mqtt", "topic": "a/#", "qos": {"qos": 1, "retain": False}}, "is not an MQTT topic"),
        ({"medium": "database", "topic": "a b"}, "is not the name of a collection such as samples"),
        ({"forEach": {"x": "{{ values.kind }}"}}, "forEach x: must give a list"),
    ],
)
def test_what_gives_no_topic_is_named_with_its_interface(change: dict[str, Any], words: str) -> None:
    said = problems({**OUTPUT, **change}, kind="pose")
    assert said.startswith("spec.interfaces: interface output: ")
    assert words in said


def test_all_problems_are_named_at_once() -> None:
    said = problems({**INPUT, "topic": "x"}, {**OUTPUT, "topic": "y"}, FRAME, {**FRAME, "name": "again"})
    assert [part in said for part in ("interface input", "interface output", "mqtt out state stands twice")] == [
        True
    ] * 3
    many = {**OUTPUT, "forEach": {"n": list(range(TOPICS_MAX + 1))}, "topic": "/t{{ n }}"}
    assert f"{TOPICS_MAX + 1} topics are more than {TOPICS_MAX}" in problems(many)


def test_an_input_leads_to_the_output_of_the_same_element() -> None:
    pairs = [
        {**item, "forEach": {"n": [1, 2]}, "topic": f"/{item['name']}{{{{ n }}}}", "causes": causes}
        for item, causes in ((INPUT, "output"), (OUTPUT, ""))
    ]
    topics = expected(*pairs)
    assert [outputs_of(topics, topic) for topic in topics[:2]] == [(2,), (3,)]
    topics = expected({**INPUT, "causes": "output"}, pairs[1])
    assert outputs_of(topics, topics[0]) == (1, 2)
    assert outputs_of(topics, topics[1]) == ()


# --- what can be judged before anything runs -------------------------------------------------------------------------


def declared(*interfaces: Any, sets: dict[str, dict[str, Any]] | None = None) -> list[Check]:
    topics = {name: expected(*interfaces, **values) for name, values in (sets or {"one": {}, "two": {}}).items()}
    return [check for check in declaration_checks(interfaces, topics) if not check.passed]


def test_an_input_without_an_output_is_refused() -> None:
    (check,) = declared(INPUT, OUTPUT)
    assert check.name == "interface input states its output"
    assert "it has no `causes`" in check.found
    assert "write causes: one of output" in check.fix
    (check,) = declared(INPUT)
    assert check.found.startswith("nothing shows that the input is used")
    assert "declare what the chart gives out" in check.fix
    (check,) = declared({**INPUT, "causes": "nobody"}, OUTPUT)
    assert "'nobody', which is no interface of direction out" in check.found
    assert declared({**INPUT, "causes": "stored"}, STORED) == []


def test_sets_that_give_the_same_topics_are_refused_when_there_are_templates_or_patterns() -> None:
    template = {**OUTPUT, "topic": "/{{ values.name }}/out"}
    assert declared(template, sets={"one": {"name": "a"}, "two": {"name": "b"}}) == []
    (check,) = declared(template, sets={"one": {"name": "a"}, "two": {"name": "a"}})
    assert check.found == "one and two both give ros out /a/out"
    assert "give every set values that lead to other topics" in check.fix
    (check,) = declared({**OUTPUT, "topic": "/vehicles/{agent}/pose"})
    assert "ros out /vehicles/{agent}/pose" in check.found
    assert declared(OUTPUT) == []


# --- what was seen ---------------------------------------------------------------------------------------------------


def test_what_is_declared_and_seen_passes_besides_what_every_node_opens() -> None:
    topics = expected({**INPUT, "causes": "output"}, OUTPUT, FRAME, STORED)
    common = [Endpoint(name, way, kind, "reliable", "volatile", "/n") for (name, way), kind in COMMON_TOPICS.items()]
    seen = Observation(
        endpoints=(end(topics[0]), end(topics[1]), *common),
        publications=(ObservedPublication("state", 1, False, "rkf1"),),
        collections=("samples",),
        answers=(InputResponse(0, 1, 0.2),),
        seconds=3.0,
    )
    assert failed(topics, seen) == {}
    assert len(compare("s", topics, seen)) == 6
    assert {check.name for check in compare("s", (), Observation())} == {"set s: no undeclared topics"}


@pytest.mark.parametrize(
    ("change", "name", "words"),
    [
        (
            {"topic": "/other"},
            "ros out /out: declared but absent",
            "no node of the chart had a publisher of /out; it publishes to /other",
        ),
        (
            {"direction": "in"},
            "ros out /out: declared but absent",
            "it publishes to nothing -> open it, or correct interface output",
        ),
        (
            {"type": POSE},
            "ros out /out: wrong type",
            f"as {POSE}, declared is {STRING} -> use {STRING}, or declare type {POSE}",
        ),
        (
            {"reliability": "best_effort"},
            "ros out /out: wrong reliability",
            "its publisher is best_effort, declared is reliable",
        ),
        (
            {"durability": "transient_local"},
            "ros out /out: wrong durability",
            "or declare qos.durability: transient_local",
        ),
    ],
)
def test_a_deviation_on_ros_is_said_with_its_fix(change: dict[str, str], name: str, words: str) -> None:
    (topic,) = expected(OUTPUT)
    deviations = failed((topic,), Observation(endpoints=(end(topic, **change),), seconds=3.0))
    assert words in deviations[f"set s: {name}"]


def test_one_wrong_endpoint_among_right_ones_is_found() -> None:
    (topic,) = expected(OUTPUT)
    deviations = failed((topic,), Observation(endpoints=(end(topic), end(topic, type=POSE, node="/b"))))
    assert list(deviations) == ["set s: ros out /out: wrong type"]


@pytest.mark.parametrize(
    ("seen", "name", "words"),
    [
        (
            Observation(seconds=9.0),
            "declared but absent",
            "in 9 s nothing was published to state; it published to nothing",
        ),
        (Observation(publications=(ObservedPublication("state", 0, False),)), "wrong QoS", "with QoS 0, declared is 1"),
        (
            Observation(publications=(ObservedPublication("state", 1, True),)),
            "wrong retain flag",
            "with the retain flag, declared is without it",
        ),
        (
            Observation(publications=(ObservedPublication("state", 1, False, "text"),)),
            "wrong encoding",
            "its content is text, declared is rkf1",
        ),
        (
            Observation(publications=(ObservedPublication("state", 1, False, "rkf1", "2 bytes"),)),
            "wrong type",
            "2 bytes",
        ),
    ],
)
def test_a_deviation_at_the_broker_is_said_with_its_fix(seen: Observation, name: str, words: str) -> None:
    deviations = failed(expected(FRAME), seen)
    assert words in deviations[f"set s: mqtt out state: {name}"]
    assert "interface frame" in deviations[f"set s: mqtt out state: {name}"]


def test_what_nobody_declared_is_found_everywhere() -> None:
    seen = Observation(
        endpoints=(Endpoint("/hidden", "in", POSE, "reliable", "volatile", "/spy"),),
        publications=(ObservedPublication("secret", 0, False),),
        subscriptions=(Subscription("state/#", 1),),
        collections=("samples", "other"),
    )
    deviations = failed(expected(FRAME, STORED), seen)
    assert f"node /spy subscribes to /hidden ({POSE}), which" in deviations["set s: undeclared topic ros in /hidden"]
    assert "set s: undeclared topic mqtt out secret" in deviations
    assert "set s: undeclared topic mqtt in state/#" in deviations
    assert "collection other was made" in deviations["set s: undeclared collection database out other"]
    assert not any("samples" in name for name in deviations)


def test_an_output_is_not_an_input_of_the_same_topic() -> None:
    (topic,) = expected(OUTPUT)
    deviations = failed((topic,), Observation(endpoints=(end(topic), end(topic, direction="in"))))
    assert list(deviations) == ["set s: undeclared topic ros in /out"]


def test_a_topic_of_every_node_with_another_type_is_undeclared() -> None:
    seen = Observation(endpoints=(Endpoint("/rosout", "out", STRING, "reliable", "volatile", "/n"),))
    assert list(failed((), seen)) == ["set s: undeclared topic ros out /rosout"]


@pytest.mark.parametrize("answers", [(), (InputResponse(0, None, 8.0),)])
def test_an_input_that_leads_to_nothing_is_said(answers: tuple[InputResponse, ...]) -> None:
    topics = expected({**INPUT, "causes": "output"}, OUTPUT)
    seen = Observation(endpoints=(end(topics[0]), end(topics[1])), answers=answers)
    (words,) = failed(topics, seen).values()
    assert f"after messages ({STRING}) were sent to /in nothing was seen" in words
    assert "on ros out /out -> use the input, or correct `causes` of interface input" in words


OBSERVER_ID = f"suite-abc-{'0' * 32}"
LOG = f"""\
1763750000: New connection from 10.0.0.1:34567 on port 1883.
1763750000: New client connected from 10.0.0.1:34567 as vehicle-00-telemetry (p5, c0, k5, u'suite').
1763750000: Received SUBSCRIBE from vehicle-00-telemetry
1763750000: \tmqtt/route (QoS 1)
1763750000: vehicle-00-telemetry 1 mqtt/route
1763750001: Received PUBLISH from vehicle-00-telemetry (d0, q1, r1, m1, 'mqtt/pose', ... (120 bytes))
1763750001: Received PUBLISH from vehicle-00-telemetry (d0, q0, r0, m0, 'state', ... (2 bytes))
1763750002: {OBSERVER_ID} 2 #
1763750002: Received PUBLISH from {OBSERVER_ID} (d0, q1, r0, m3, 'mqtt/route', ... (77 bytes))
"""


def test_the_brokers_log_tells_subscriptions_and_what_came_before_the_observer() -> None:
    seen = Observation(publications=(ObservedPublication("state", 0, False, "text"),))
    observed = with_broker_log(seen, LOG, "suite-abc")
    assert observed.subscriptions == (Subscription("mqtt/route", 1),)
    assert observed.publications == (
        ObservedPublication("state", 0, False, "text"),
        ObservedPublication("mqtt/pose", 1, True),
    )


# --- what the observer writes ----------------------------------------------------------------------------------------


def test_an_observation_is_read_as_it_was_written() -> None:
    seen = Observation(
        (Endpoint("/a", "in", STRING, "reliable", "volatile", "/n"),),
        (ObservedPublication("b", 1, True, "text"),),
        (),
        ("samples",),
        (InputResponse(0, None, 1.5),),
        4.5,
    )
    document = asdict(seen)
    del document["subscriptions"]
    assert read_observation(json.loads(json.dumps(document)), "observer") == seen


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
PARTS = ("endpoints", "publications", "collections", "answers", "seconds")


@given(st.fixed_dictionaries({}, optional=dict.fromkeys(PARTS, JSON)) | st.dictionaries(st.text(max_size=8), JSON))
def test_anything_else_is_refused_in_words(document: dict[str, Any]) -> None:
    try:
        read_observation(document, "observer")
        refusal = ""
    except DocumentError as error:
        refusal = str(error)
    assert refusal.startswith("observer: ") or set(document) == set(PARTS)


def test_a_report_is_bounded_and_keeps_what_failed() -> None:
    checks = [Check(f"passed {n}", True) for n in range(CHECKS_MAX)] + [Check("wrong", False, "x", "y")]
    kept = bounded(checks)
    assert len(kept) == CHECKS_MAX
    assert kept[0].name == "wrong"
    assert (kept[-1].name, kept[-1].passed) == ("2 more checks", True)
    all_failed = bounded([Check(f"{n}", False) for n in range(2 * CHECKS_MAX)])
    assert len(all_failed) == CHECKS_MAX
    assert not all_failed[-1].passed
