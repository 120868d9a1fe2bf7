"""Links of kind mqtt: which topic goes from whom to whom, and what the broker would refuse."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from robotkube.delivery.manager.core.composition.composer import Composition, Demand, Inputs, Met, Refused, compose
from robotkube.delivery.manager.core.placement.placement import Agent, NodeState, fleet
from robotkube.delivery.tasks.core.task_description import TaskPlacement
from robotkube.foundation.documents.adapters.json_schema import validate
from robotkube.robots.bridge.core.rights import IN, OUT, may
from tests.stages.delivery.placement import RENDER, application, catalogue, demand, task

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
    links: Sequence[Mapping[str, Any]], *services: Mapping[str, Any], vehicles: Sequence[str] = ("vehicle-00",)
) -> Composition:
    known = catalogue(application(*services, links=links), BRIDGE)
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
        (VEHICLE, OTHER, POSE, "vehicle-01 (role vehicle) may not read it"),
        (SITE, VEHICLE, "/vehicles/roadside_0/plan", "vehicle-00 (role vehicle) may not read it"),
        (VEHICLE, CLOUD, "/vehicles/vehicle_01/pose", "vehicle-00 (role vehicle) may not write it"),
        (VEHICLE, CLOUD, "/pose", "vehicle-00 (role vehicle) may not write it"),
        (CLOUD, {"agent": "cloud-1"}, "/summary", "cloud-0 (role cloud) may not write it"),
        (VEHICLE, {"role": "vehicle"}, POSE, "vehicle-01 (role vehicle) may not read it"),
        ({"medium": "mqtt"}, VEHICLE, "/vehicles/vehicle_01/pose", "vehicle-00 (role vehicle) may not read it"),
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
    assert "write and read topics below /vehicles/<their own name>/ and no others" in refusal.message
    assert "placement.roles" in refusal.message
    assert composition.releases == {}


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


def test_a_link_within_one_machine_needs_no_right() -> None:
    own = service("a", "cloud-0")
    composition = composed([link(CLOUD, {"service": "a"}, "/any")], own)
    assert [release.name for release in composition.releases.values()] == ["a"]


def test_a_topic_of_any_agent() -> None:
    vehicle, _, _, cloud, _ = AGENTS
    assert may(vehicle, OUT, "/vehicles/{agent}/pose")
    assert not may(vehicle, IN, "/vehicles/{agent}/pose")
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
    clouds = link(VEHICLE, {"service": "watch"}, POSE)
    everywhere = [name for name, _ in NAMES]
    assert where(watching(clouds, able=["vehicle-01", "roadside-0", "cloud-1"])) == "cloud-1"
    assert where(watching(clouds, able=["vehicle-00", "vehicle-01"])) == "vehicle-00"
    assert where(watching(clouds, able=everywhere)) == "cloud-0"
    results = link({"service": "watch"}, {"role": "cloud"}, "/vehicles/roadside_0/objects")
    assert where(watching(results, able=["roadside-0", "vehicle-00", "vehicle-01"])) == "roadside-0"
    answers = link({"service": "watch"}, {"role": "roadside"}, "/answers")
    assert where(watching(answers, able=["roadside-0", "cloud-0"])) == "roadside-0"


def test_the_reasons_name_who_may_not() -> None:
    clouds = link(VEHICLE, {"service": "watch"}, POSE)
    (outcome,) = watching(clouds, able=["cloud-1", "roadside-0"]).outcomes.values()
    assert isinstance(outcome, Met)
    assert f"roadside-0: may not read {POSE} at the broker" in outcome.choices


def test_where_no_agent_may_the_link_is_refused() -> None:
    clouds = link(VEHICLE, {"service": "watch"}, POSE)
    for composition in (
        watching(clouds, able=["vehicle-01", "roadside-0"]),
        watching(clouds, able=["roadside-0", "cloud-0"], roles=("roadside",)),
    ):
        refusal = refused(composition)
        assert refusal.reason == "LinkNotPermitted"
        assert "may not read it at the broker" in refusal.message


def test_a_place_that_the_link_needs_but_that_is_away_is_waited_for() -> None:
    """Not another one, where the link would be refused."""
    known = catalogue(application(ANYWHERE, links=[link(VEHICLE, {"service": "watch"}, POSE)]), BRIDGE)
    able = {"roadside-0", "cloud-0"}
    nodes = [
        NodeState(a.name, a.name, a.role, frozenset({"gpu"} if a.name in able else ()), a.name != "cloud-0")
        for a in AGENTS
    ]
    refusal = refused(compose([demand(task())], Inputs(known, fleet(AGENTS, nodes), {}, RENDER, validate)))
    assert refusal.reason == "NoCapableNode"
    assert "cloud-0: no Node is Ready" in refusal.message
    assert "roadside-0: may not read" in refusal.message
