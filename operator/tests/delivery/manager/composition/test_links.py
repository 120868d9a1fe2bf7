"""Links of kind mqtt: which topic goes from whom to whom, and what broker or charts at the ends would refuse."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from robotkube.delivery.manager.core.composition.composer import Composition, Demand, Inputs, Met, Refused, compose
from robotkube.delivery.manager.core.placement.placement import Agent, NodeState, fleet
from robotkube.delivery.tasks.core.task_description import TaskPlacement
from robotkube.foundation.documents.adapters.json_schema import validate
from robotkube.robots.bridge.core.rights import IN, OUT, may
from tests.stages.attacks import shown
from tests.stages.delivery.manager.placement import RENDER, application, catalogue, chart, demand, task

NAMES = [("vehicle-00", "vehicle"), ("vehicle-01", "vehicle"), ("roadside-0", "roadside"), ("cloud-0", "cloud")]
NAMES += [("cloud-1", "cloud")]
AGENTS = [Agent(name, role, name) for name, role in NAMES]
QUALITY = {"channel": "telemetry", "reliability": "reliable", "durability": "volatile", "depth": 10}
EVERY = {"vehicle": "{{ parameters.agents }}"}
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


def topic(name: str) -> dict[str, Any]:
    return {"name": name, "type": "std_msgs/msg/String", **QUALITY}


def link(source: Mapping[str, str], target: Mapping[str, str], *topics: str, **more: Any) -> dict[str, Any]:
    return {
        "kind": "mqtt",
        "from": dict(source),
        "to": dict(target),
        "topics": [topic(name) for name in topics],
        **more,
    }


def service(name: str, agent: str, **more: Any) -> dict[str, Any]:
    loop = "-{{ vehicle }}" if "forEach" in more else ""
    return {"name": name, "release": f"{name}{loop}", "placement": {"agent": agent}, **more}


def composed(
    links: Sequence[Mapping[str, Any]],
    *services: Mapping[str, Any],
    vehicles: Sequence[str] = ("vehicle-00",),
    charts: Sequence[tuple[str, str]] = (),
) -> Composition:
    known = catalogue(application(*services, links=links), BRIDGE, *charts)
    nodes = [NodeState(agent.name, agent.name, agent.role, frozenset(), True) for agent in AGENTS]
    asked: Demand = demand(task(parameters={"agents": list(vehicles)}))
    return compose([asked], Inputs(known, fleet(AGENTS, nodes), {}, RENDER, validate))


def carried(composition: Composition) -> dict[str, tuple[list[str], list[str]]]:
    """What leaves and what enters each agent by its bridge."""
    assert all(isinstance(outcome, Met) for outcome in composition.outcomes.values()), composition.outcomes
    bridges = {r.namespace: r.values["bridge"] for r in composition.releases.values() if r.name == "mqtt-bridge"}
    return {
        agent: ([one["name"] for one in bridge["out"]], [one["name"] for one in bridge["in"]])
        for agent, bridge in bridges.items()
    }


def refused(composition: Composition) -> Refused:
    (outcome,) = composition.outcomes.values()
    assert isinstance(outcome, Refused), outcome
    return outcome


VEHICLE, OTHER, SITE, CLOUD = ({"agent": name} for name in ("vehicle-00", "vehicle-01", "roadside-0", "cloud-0"))
COMMAND, POSE = "/vehicles/vehicle_00/command", "/vehicles/vehicle_00/pose"


@pytest.mark.parametrize(
    ("source", "target", "name", "words"),
    [
        (CLOUD, VEHICLE, COMMAND, "cloud-0 (role cloud) may not write it"),
        (VEHICLE, OTHER, "/vehicles/vehicle_01/pose", "vehicle-00 (role vehicle) may not write it"),
        (SITE, VEHICLE, "/agents/vehicle_00/plan", "roadside-0 (role roadside) may not write it"),
        (CLOUD, VEHICLE, "/agents/cloud_1/plan", "cloud-0 (role cloud) may not write it"),
        (VEHICLE, CLOUD, "/vehicles/vehicle_01/pose", "vehicle-00 (role vehicle) may not write it"),
        (VEHICLE, CLOUD, "/pose", "vehicle-00 (role vehicle) may not write it"),
        (CLOUD, {"agent": "cloud-1"}, "/summary", "cloud-0 (role cloud) may not write it"),
        ({"medium": "mqtt"}, VEHICLE, "/robotkube/tasks", "vehicle-00 (role vehicle) may not read it"),
        (VEHICLE, CLOUD, "/robotkube/task_status", "vehicle-00 (role vehicle) may not write it"),
    ],
)
def test_a_link_that_cannot_pass_is_refused(
    source: dict[str, str], target: dict[str, str], name: str, words: str
) -> None:
    composition = composed([link(source, target, name)])
    refusal = refused(composition)
    assert refusal.reason == "LinkNotPermitted"
    assert f"topic {name} cannot go from " in refusal.message
    assert words in refusal.message
    assert "every agent writes topics below /agents/<its own name>/" in refusal.message
    assert "placement.roles" in refusal.message
    assert composition.releases == {}


def test_a_type_that_no_bridge_knows_is_refused_where_a_bridge_would_carry_it() -> None:
    own = link(VEHICLE, CLOUD, POSE)
    own["topics"][0]["type"] = "rover_msgs/msg/Fix"
    composition = composed([own])
    refusal = refused(composition)
    assert refusal.reason == "LinkTypeUnknown"
    assert f"topic {POSE}: type rover_msgs/msg/Fix: none of the packaged images has the message" in refusal.message
    assert "so no bridge carries it; take a type of docs/reference/message-types.md" in refusal.message
    assert composition.releases == {}
    assert carried(composed([{**own, "to": dict(VEHICLE)}])) == {}  # ROS itself carries it on one place


def interface(direction: str, name: str, kind: str, reliability: str, durability: str) -> dict[str, Any]:
    qos = {"reliability": reliability, "durability": durability}
    declared = {"name": direction, "medium": "ros", "direction": direction, "topic": name}
    return {**declared, "type": kind, "qos": qos}


OPENING = [
    interface("in", "{{ values.heard }}", "std_msgs/msg/String", "reliable", "volatile"),
    interface("out", "{{ values.said }}", "std_msgs/msg/String", "best_effort", "volatile"),
]
OPENER = chart("opener", interfaces=OPENING)
SAYS = {
    "chart": {"name": "opener", "version": ">=0.1.0"},
    "values": {"said": POSE, "heard": "/vehicles/{vehicle}/pose"},
}
SPEAKER = service("speaker", "vehicle-00", **SAYS)
HEARER = service("hearer", "cloud-0", **{**SAYS, "values": {**SAYS["values"], "said": "/agents/cloud_0/heard"}})
FROM_SPEAKER, TO_HEARER = {"service": "speaker"}, {"service": "hearer"}


@pytest.mark.parametrize(
    ("source", "target", "change", "words"),
    [
        (
            VEHICLE,
            TO_HEARER,
            {"type": "std_msgs/msg/Float64"},
            "type: topic /vehicles/{vehicle}/pose is std_msgs/msg/F",
        ),
        (
            FROM_SPEAKER,
            CLOUD,
            {"type": "std_msgs/msg/Float64"},
            f"type: topic {POSE} is std_msgs/msg/Float64 here, and",
        ),
        (
            FROM_SPEAKER,
            CLOUD,
            {},
            "reliability: topic /vehicles/vehicle_00/pose: the link requests reliable, and inter",
        ),
        (
            VEHICLE,
            TO_HEARER,
            {"reliability": "best_effort"},
            "(service hearer) requests reliable: ROS does not connect",
        ),
        (
            VEHICLE,
            TO_HEARER,
            {"name": COMMAND.replace("command", "posed")},
            "(direction in): it has /vehicles/{vehicle}",
        ),
        (
            FROM_SPEAKER,
            CLOUD,
            {"name": COMMAND},
            "name: no interface of chart opener (service speaker) sends /vehicles/v",
        ),
    ],
)
def test_a_topic_that_a_chart_at_an_end_opens_otherwise_is_refused(
    source: dict[str, str], target: dict[str, str], change: dict[str, str], words: str
) -> None:
    own = link(source, target, POSE)
    own["topics"][0] |= change
    refusal = refused(composed([own], SPEAKER, HEARER, charts=[OPENER]))
    assert refusal.reason == "LinkMismatch"
    assert refusal.message.startswith("spec.links[0].topics[0].")
    assert words in refusal.message


def test_what_the_charts_at_the_ends_open_as_the_link_says_is_composed() -> None:
    """More than is requested is offered; charts without interfaces say nothing."""
    weak = link(FROM_SPEAKER, CLOUD, POSE)
    weak["topics"][0]["reliability"] = "best_effort"
    strong = link(SITE, TO_HEARER, "/vehicles/roadside_0/pose")
    strong["topics"][0]["durability"] = "transient_local"
    mute = link(VEHICLE, {"service": "mute"}, COMMAND)
    composition = composed([weak, strong, mute], SPEAKER, HEARER, service("mute", "cloud-1"), charts=[OPENER])
    assert carried(composition)["vehicle-00"] == ([COMMAND, POSE], [])
    assert carried(composition)["cloud-0"] == ([], ["/vehicles/roadside_0/pose", POSE])


def test_a_topic_may_be_that_of_a_chart_beside_the_end() -> None:
    own = link({"service": "mute"}, CLOUD, POSE)
    own["topics"][0]["reliability"] = "best_effort"
    for name in ("opener", "worker"):
        mute = service(
            "mute", "vehicle-00", chart={"name": name, "version": ">=0.1.0"}, values={"said": "/a", "heard": "/b"}
        )
        assert carried(composed([own], mute, SPEAKER, charts=[OPENER]))["vehicle-00"] == ([POSE], [])


def test_what_may_pass_is_composed() -> None:
    links = [
        link(VEHICLE, {"role": "cloud"}, POSE),
        link({"medium": "mqtt"}, VEHICLE, COMMAND),
        link(VEHICLE, {"medium": "mqtt"}, "/robotkube/tasks"),
        link(CLOUD, {"medium": "mqtt"}, "/robotkube/tasks"),
    ]
    assert carried(composed(links)) == {
        "vehicle-00": (["/robotkube/tasks", POSE], [COMMAND]),
        "cloud-0": (["/robotkube/tasks"], [POSE]),
        "cloud-1": ([], [POSE]),
    }


@pytest.mark.parametrize(
    ("source", "target", "name"),
    [
        (VEHICLE, OTHER, POSE),
        (VEHICLE, SITE, POSE),
        (SITE, VEHICLE, "/vehicles/roadside_0/objects"),
        (CLOUD, VEHICLE, "/agents/cloud_0/plan"),
        (CLOUD, {"agent": "cloud-1"}, "/agents/cloud_0/summary"),
        (VEHICLE, CLOUD, "/agents/vehicle_00/status"),
    ],
)
def test_links_go_from_any_agent_to_any_other(source: dict[str, str], target: dict[str, str], name: str) -> None:
    assert carried(composed([link(source, target, name)])) == {
        source["agent"]: ([name], []),
        target["agent"]: ([], [name]),
    }


def test_a_link_within_one_machine_needs_no_right() -> None:
    own = service("a", "cloud-0")
    composition = composed([link(CLOUD, {"service": "a"}, "/any")], own)
    assert [release.name for release in composition.releases.values()] == ["a"]


def test_a_topic_of_any_agent() -> None:
    vehicle, _, _, cloud, _ = AGENTS
    assert may(vehicle, OUT, "/vehicles/{agent}/pose")
    assert may(vehicle, IN, "/vehicles/{agent}/pose")
    assert may(cloud, OUT, "/agents/{agent}/plan")
    assert may(cloud, IN, "/vehicles/{agent}/pose")
    assert not may(cloud, OUT, "/vehicles/{agent}/pose")


# -- loops ------------------------------------------------------------------------------------------------------------

BOTH = ("vehicle-00", "vehicle-01")
OWN_TOPIC = "/vehicles/{{ vehicle | ros }}/status"


def on_every(name: str) -> dict[str, Any]:
    return service(name, "{{ vehicle }}", forEach=EVERY)


def test_the_topics_of_a_vehicle_leave_by_its_own_bridge_alone() -> None:
    """A link and the service at its end with the same `forEach`: each instance has its own vehicle's topics."""
    out = link({"service": "watch"}, {"role": "cloud"}, OWN_TOPIC, forEach=EVERY)
    assert carried(composed([out], on_every("watch"), vehicles=BOTH)) == {
        "vehicle-00": (["/vehicles/vehicle_00/status"], []),
        "vehicle-01": (["/vehicles/vehicle_01/status"], []),
        "cloud-0": ([], ["/vehicles/vehicle_00/status", "/vehicles/vehicle_01/status"]),
        "cloud-1": ([], ["/vehicles/vehicle_00/status", "/vehicles/vehicle_01/status"]),
    }


def test_a_link_without_a_loop_takes_those_of_its_services() -> None:
    links = [
        link({"service": "watch"}, {"agent": "cloud-0"}, OWN_TOPIC),
        link({"agent": "{{ vehicle }}"}, {"service": "sum"}, "/vehicles/{{ vehicle | ros }}/pose"),
    ]
    summing = service("sum", "cloud-1", forEach=EVERY)
    assert carried(composed(links, on_every("watch"), summing, vehicles=BOTH)) == {
        f"vehicle-0{number}": ([f"/vehicles/vehicle_0{number}/{word}" for word in ("pose", "status")], [])
        for number in (0, 1)
    } | {
        f"cloud-{number}": ([], [f"/vehicles/vehicle_0{vehicle}/{word}" for vehicle in (0, 1)])
        for number, word in ((0, "status"), (1, "pose"))
    }


def test_two_services_with_one_loop_are_linked_pair_by_pair() -> None:
    """With all pairs, the second vehicle would have made a circle: each would hear what the other one sends."""
    pairs = link({"service": "watch"}, {"service": "sum"}, OWN_TOPIC)
    summing = service("sum", "cloud-{{ vehicle[-1:] }}", forEach=EVERY)
    assert carried(composed([pairs], on_every("watch"), summing, vehicles=BOTH)) == {
        "vehicle-00": (["/vehicles/vehicle_00/status"], []),
        "vehicle-01": (["/vehicles/vehicle_01/status"], []),
        "cloud-0": ([], ["/vehicles/vehicle_00/status"]),
        "cloud-1": ([], ["/vehicles/vehicle_01/status"]),
    }


def test_without_a_variable_in_common_everything_is_linked() -> None:
    out = link({"service": "watch"}, {"agent": "cloud-0"}, "/vehicles/{{ placement.watch | ros }}/status")
    other = {"car": "{{ parameters.agents }}"}
    named = {**on_every("watch"), "forEach": other, "placement": {"agent": "{{ car }}"}, "release": "watch-{{ car }}"}
    one = carried(composed([{**out, "forEach": EVERY}], named, vehicles=("vehicle-00",)))
    assert one == {
        "vehicle-00": (["/vehicles/vehicle_00/status"], []),
        "cloud-0": ([], ["/vehicles/vehicle_00/status"]),
    }


# -- placement --------------------------------------------------------------------------------------------------------

ANYWHERE: dict[str, Any] = {"name": "watch", "release": "watch", "placement": {"capabilities": ["gpu"]}}


def watching(*links: Mapping[str, Any], able: Sequence[str], **placement: Any) -> Composition:
    """A service that may run on any of the able agents, with these links."""
    known = catalogue(application(ANYWHERE, links=links), BRIDGE)
    capable = {name: frozenset({"gpu"}) for name in able}
    nodes = [NodeState(a.name, a.name, a.role, capable.get(a.name, frozenset()), True) for a in AGENTS]
    asked = demand(task(placement=TaskPlacement(**placement)))
    return compose([asked], Inputs(known, fleet(AGENTS, nodes), {}, RENDER, validate))


def where(composition: Composition) -> str:
    assert all(isinstance(outcome, Met) for outcome in composition.outcomes.values()), composition.outcomes
    (release,) = (one for one in composition.releases.values() if one.name == "watch")
    return release.namespace


def test_a_service_goes_where_its_links_pass() -> None:
    """By the number of releases and by name, the first of them would be taken."""
    results = link({"service": "watch"}, {"role": "cloud"}, "/vehicles/roadside_0/objects")
    assert where(watching(results, able=["roadside-0", "vehicle-00", "vehicle-01"])) == "roadside-0"
    answers = link({"service": "watch"}, {"role": "roadside"}, "/answers")
    assert where(watching(answers, able=["roadside-0", "cloud-0"])) == "roadside-0"
    own = link({"service": "watch"}, VEHICLE, "/agents/cloud_1/answers")
    assert where(watching(own, able=["cloud-0", "cloud-1", "roadside-0"])) == "cloud-1"


def test_every_place_may_read() -> None:
    clouds = link(VEHICLE, {"service": "watch"}, POSE)
    for able in ("vehicle-01", "roadside-0", "cloud-1"):
        assert where(watching(clouds, able=[able])) == able


RESULTS = link({"service": "watch"}, {"role": "cloud"}, "/vehicles/roadside_0/objects")


def test_the_reasons_name_who_may_not() -> None:
    (outcome,) = watching(RESULTS, able=["vehicle-00", "roadside-0"]).outcomes.values()
    assert isinstance(outcome, Met)
    assert "vehicle-00: may not write /vehicles/roadside_0/objects at the broker" in outcome.choices


def test_where_no_agent_may_the_link_is_refused() -> None:
    for composition in (
        watching(RESULTS, able=["vehicle-00", "vehicle-01"]),
        watching(RESULTS, able=["roadside-0", "vehicle-00"], roles=("vehicle",)),
    ):
        refusal = refused(composition)
        assert refusal.reason == "LinkNotPermitted"
        shown("selection", refusal.message, "topic-of-another")


def test_a_place_that_the_link_needs_but_that_is_away_is_waited_for() -> None:
    """Not another one, where the link would be refused."""
    known = catalogue(application(ANYWHERE, links=[RESULTS]), BRIDGE)
    able = {"roadside-0", "vehicle-00"}
    nodes = [
        NodeState(a.name, a.name, a.role, frozenset({"gpu"} if a.name in able else ()), a.name != "roadside-0")
        for a in AGENTS
    ]
    refusal = refused(compose([demand(task())], Inputs(known, fleet(AGENTS, nodes), {}, RENDER, validate)))
    assert refusal.reason == "NoCapableNode"
    assert "roadside-0: no Node is Ready" in refusal.message
    assert "vehicle-00: may not write" in refusal.message


@pytest.mark.parametrize("deadline", [{}, {"deadline_seconds": 0.5}])
def test_kind_and_deadline_of_a_topic_reach_both_bridges(deadline: dict[str, float]) -> None:
    carries = {**topic(POSE), "channel": "safety", **deadline}
    one = {"kind": "mqtt", "from": dict(VEHICLE), "to": dict(CLOUD), "topics": [carries]}
    releases = composed([one]).releases.values()
    ends = {release.namespace: release.values["bridge"] for release in releases}
    assert (ends["vehicle-00"]["out"], ends["cloud-0"]["in"]) == ([carries], [carries])


# -- one topic asked for in two ways ----------------------------------------------------------------------------------

SOON, EVER = (
    {"kind": "mqtt", "from": dict(VEHICLE), "to": dict(CLOUD), "topics": [{**topic(POSE), **deadline}]}
    for deadline in ({"deadline_seconds": 0.5}, {})
)


def test_two_deadlines_of_one_topic_are_told() -> None:
    refusal = refused(composed([SOON, EVER]))
    assert refusal.reason == "CompositionFailed"
    assert refusal.message == (
        f"topic {POSE} is asked for with no deadline_seconds at the mqtt bridge of vehicle-00, which carries it with "
        "deadline_seconds 0.5 for another link of application app: a bridge carries a topic in one way; write the same "
        "in both links"
    )


def by_two(first: Mapping[str, Any], second: Mapping[str, Any]) -> Refused:
    """The refusal of task ops/second, whose application `late` has the link `second`."""
    known = catalogue(application(links=[first], name="early"), application(links=[second], name="late"), BRIDGE)
    nodes = [NodeState(agent.name, agent.name, agent.role, frozenset(), True) for agent in AGENTS]
    asked = [demand(task("first", application="early")), demand(task("second", application="late"))]
    composition = compose(asked, Inputs(known, fleet(AGENTS, nodes), {}, RENDER, validate))
    assert isinstance(composition.outcomes["ops/first"], Met)
    outcome = composition.outcomes["ops/second"]
    assert isinstance(outcome, Refused)
    return outcome


def test_a_topic_that_another_task_has_carried_otherwise_names_task_and_application() -> None:
    assert by_two(SOON, EVER).message.endswith(
        "which carries it with deadline_seconds 0.5 for task ops/first (application early), which can be withdrawn: a "
        "bridge carries a topic in one way; write the same in both links"
    )


def test_a_loop_with_another_task_names_task_and_application() -> None:
    plan = "/agents/vehicle_00/plan"
    assert by_two(link(VEHICLE, CLOUD, plan), link({"medium": "mqtt"}, VEHICLE, plan)).message == (
        f"topic {plan} leaves vehicle-00 by its mqtt bridge for task ops/first (application early), which can be "
        "withdrawn, and would enter by it as well: a loop; give one of both topics another name"
    )
