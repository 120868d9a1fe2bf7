"""Agents with several Nodes: ROS does not cross Nodes, so what hears each other is on one, with the bridge it needs."""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pytest

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.composition.composer import Composition, Demand, Inputs, Memo, Met, compose
from robotkube.delivery.manager.core.placement.capacity import Resources
from robotkube.delivery.manager.core.placement.placement import NodeState, fleet
from robotkube.delivery.manager.core.plans import differences, lost_node_text
from robotkube.foundation.documents.adapters.json_schema import validate
from robotkube.robots.ros.core.topic_patterns import ros_name
from tests.stages.delivery.manager.placement import (
    AGENTS,
    HALF,
    NODES,
    RENDER,
    SECOND,
    application,
    catalogue,
    chart,
    demand,
    inputs,
    places,
    refusal,
    several,
    task,
)
from tests.stages.examples import EXAMPLES

ROOM = Resources(1000, 2**30)
EDGE = {"role": "roadside"}
TWO = [replace(NODES[0], name=f"n{number}", created=number, allocatable=ROOM) for number in (1, 2)]
PAIR = [
    {"name": "a", "release": "a-{{ task.name }}", "placement": EDGE},
    {"name": "b", "release": "b-{{ task.name }}", "placement": EDGE},
]
ROS = {"kind": "ros", "from": {"service": "a"}, "to": {"service": "b"}}
LINKED = catalogue(application(*PAIR, links=[ROS]))
QUALITY = {"channel": "telemetry", "reliability": "reliable", "durability": "volatile", "depth": 10}
POSE = {"name": "/vehicles/roadside_0/pose", "type": "geometry_msgs/msg/PoseStamped", **QUALITY}
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
BOUND = {"name": "a", "release": "a-{{ task.name }}", "placement": {"agent": "roadside-0"}}
TO_SERVICE = {"kind": "mqtt", "from": {"agent": "roadside-0"}, "to": {"service": "a"}, "topics": [POSE]}


def lost(node: NodeState) -> NodeState:
    return replace(node, ready=False, not_ready_since=0)


def standing(desired: Composition) -> dict[str, Release]:
    return {release.path: release for release in desired.releases.values()}


def placements(desired: Composition) -> dict[str, Mapping[str, Any]]:
    assert all(isinstance(outcome, Met) for outcome in desired.outcomes.values()), desired.outcomes
    return {release.name: release.values["placement"] for release in desired.releases.values()}


def nodes_of(desired: Composition) -> dict[str, str]:
    return {name: placement.get("node", "") for name, placement in placements(desired).items()}


def spots(desired: Composition) -> dict[str, tuple[Any, Any]]:
    by_path = {release.path: release.values["placement"] for release in desired.releases.values()}
    return {path: (placed["agent"], placed.get("node")) for path, placed in by_path.items()}


def test_with_one_node_no_node_is_named() -> None:
    composition = placements(compose([demand(task())], inputs(LINKED)))
    assert composition == {
        "a-t": {"agent": "roadside-0", "movable": True},
        "b-t": {"agent": "roadside-0", "movable": True},
    }
    bound = placements(compose([demand(task())], inputs(catalogue(application(BOUND)))))
    assert bound == {"a-t": {"agent": "roadside-0"}}


def test_a_group_is_on_one_node_and_the_next_one_where_there_is_room() -> None:
    composition = placements(compose(several(2), inputs(LINKED, TWO)))
    assert {name: (p["agent"], p["node"]) for name, p in composition.items()} == {
        "a-t0": ("roadside-0", "n1"),
        "b-t0": ("roadside-0", "n1"),
        "a-t1": ("roadside-0", "n2"),
        "b-t1": ("roadside-0", "n2"),
    }
    third = refusal(compose(several(3), inputs(LINKED, TWO)), "ops/t2")
    assert third.reason == "InsufficientResources"
    assert "roadside-0 (Node n1): has not enough room: cpu 1000m of 0m free" in third.message
    assert "roadside-0 (Node n2): has not enough room" in third.message


def test_a_group_must_fit_on_one_node_although_both_together_have_room() -> None:
    thin = [replace(node, allocatable=Resources(600, 2**30)) for node in TWO]
    assert refusal(compose([demand(task())], inputs(LINKED, thin))).reason == "InsufficientResources"
    assert len(places(compose([demand(task())], inputs(catalogue(application(*PAIR)), thin)))) == 2


def test_a_capability_is_that_of_a_node() -> None:
    able = [TWO[0], replace(TWO[1], capabilities=frozenset({"disk"}))]
    services = [PAIR[0], {**PAIR[1], "placement": {"role": "roadside", "capabilities": ["disk"]}}]
    composition = compose([demand(task())], inputs(catalogue(application(*services, links=[ROS])), able))
    assert nodes_of(composition) == {"a-t": "n2", "b-t": "n2"}


def test_what_runs_stays_when_nodes_come_and_go_that_it_is_not_on() -> None:
    first = compose([demand(task())], inputs(LINKED, [TWO[1]]))
    assert nodes_of(first) == {"a-t": "", "b-t": ""}
    joined = [replace(TWO[0], created=5), TWO[1]]  # the Node that was there before is the older one
    second = compose([demand(task())], inputs(LINKED, joined, present=standing(first)))
    assert nodes_of(second) == {"a-t": "n2", "b-t": "n2"}
    cordoned = [joined[0], replace(joined[1], cordoned=True)]
    assert compose([demand(task())], inputs(LINKED, cordoned, present=standing(second))).releases == second.releases
    alone = compose([demand(task())], inputs(LINKED, [TWO[1]], present=standing(second)))
    assert alone.releases == second.releases  # no pod is started anew because the other Node is gone


def test_the_home_follows_what_comes_to_main() -> None:
    memo = Memo()
    asked = [demand(task())]
    given = inputs(catalogue(application(BOUND)), TWO)
    composed = compose(asked, given, memo)
    assert nodes_of(composed) == {"a-t": "n1"}
    [(path, release)] = composed.releases.items()
    moved = replace(release, values={**release.values, "placement": {"agent": "roadside-0", "node": "n2"}})
    assert nodes_of(compose(asked, replace(given, present={path: moved}), memo)) == {"a-t": "n2"}


@pytest.mark.parametrize("gone", [False, True])
def test_a_lost_node_of_two_gives_its_services_to_the_other_one(gone: bool) -> None:
    others = [node for node in NODES if node.agent != "roadside-0"]
    first = compose([demand(task())], inputs(LINKED, [*TWO, *others]))
    assert set(nodes_of(first).values()) == {"n1"}
    left = [TWO[1], *others] if gone else [lost(TWO[0]), TWO[1], *others]
    around = inputs(LINKED, left, now=50, present=standing(first))
    second = compose([demand(task())], around)
    assert places(second) == {"a-t": "roadside-0", "b-t": "roadside-0"}
    assert set(nodes_of(second).values()) == {"" if gone else "n2"}
    words = lost_node_text(differences(second.releases, standing(first)), around.fleet, 50 * SECOND)
    why, where = ("agent roadside-0 has no node n1", "its other node") if gone else ("node n1 lost for 50 s", "node n2")
    assert words == f"{why}: a-t moved to {where}, b-t moved to {where}"
    anew = [replace(TWO[0], created=60 if gone else 1), TWO[1]]
    back = compose([demand(task())], inputs(LINKED, [*anew, *others], present=standing(second)))
    assert set(nodes_of(back).values()) == {"n2"}


def test_what_is_bound_moves_to_the_other_node_of_its_agent_and_stays_there() -> None:
    known = catalogue(application(BOUND, links=[TO_CLOUD]), BRIDGE)
    cloud = [node for node in NODES if node.agent == "cloud-0"]
    first = compose([demand(task())], inputs(known, [*TWO, *cloud]))
    assert nodes_of(first) == {"a-t": "n1", "mqtt-bridge-n1": "n1", "mqtt-bridge": ""}
    second = compose([demand(task())], inputs(known, [lost(TWO[0]), TWO[1], *cloud], 50, present=standing(first)))
    assert nodes_of(second) == {"a-t": "n2", "mqtt-bridge-n2": "n2", "mqtt-bridge": ""}
    third = compose([demand(task())], inputs(known, [*TWO, *cloud], present=standing(second)))
    assert third.releases == second.releases
    waiting = compose([demand(task())], inputs(known, [*map(lost, TWO), *cloud], 50, present=standing(second)))
    assert waiting.releases == second.releases


OWN = {**POSE, "name": "/vehicles/{{ placement.a | ros }}/pose"}
TO_CLOUD = {"kind": "mqtt", "from": {"service": "a"}, "to": {"role": "cloud"}, "topics": [OWN]}


def test_the_bridge_is_on_the_node_of_whom_it_serves() -> None:
    known = catalogue(
        application({**PAIR[0], "placement": {"role": "roadside", "capabilities": ["disk"]}}, links=[TO_SERVICE]),
        BRIDGE,
    )
    able = [TWO[0], replace(TWO[1], capabilities=frozenset({"disk"}))]
    desired = compose([demand(task())], inputs(known, [replace(node, allocatable=None) for node in able]))
    assert nodes_of(desired) == {"a-t": "n2", "mqtt-bridge-n1": "n1", "mqtt-bridge-n2": "n2"}
    bridges = {release.name: release.values["bridge"] for release in desired.releases.values() if release.name != "a-t"}
    assert bridges == {
        "mqtt-bridge-n1": {"out": [POSE], "in": []},  # the agent's own topics leave its home,
        "mqtt-bridge-n2": {"out": [], "in": [POSE]},  # and reach the other Node like any other machine
    }
    assert placements(desired)["mqtt-bridge-n1"] == {"agent": "roadside-0", "node": "n1"}
    assert placements(desired)["mqtt-bridge-n2"] == {"agent": "roadside-0", "node": "n2", "movable": True}


def test_names_of_bridges_stay_short() -> None:
    far = replace(TWO[0], name="ip-10-0-0-1.somewhere.compute.internal")
    known = catalogue(application(BOUND, links=[TO_CLOUD]), BRIDGE)
    desired = compose([demand(task())], inputs(known, [far, TWO[1], NODES[-1]]))
    (name,) = [name for name, node in nodes_of(desired).items() if node == far.name and name != "a-t"]
    assert len(name) == len("mqtt-bridge-") + 8


def test_a_release_that_two_demands_share_is_on_one_node() -> None:
    shared = {**PAIR[0], "release": "shared"}
    other = application(shared, PAIR[1], name="other")
    known = catalogue(application(shared), other, chart("worker", resources=HALF))
    demands = [demand(task("t")), demand(task("u", application="other"))]
    desired = compose(demands, inputs(known, TWO))
    assert len({nodes_of(desired)[name] for name in ("shared",)}) == 1
    assert len(desired.releases) == 2


def machines(chance: random.Random) -> list[NodeState]:
    """One to three Nodes for every agent, in any state."""
    nodes = []
    for agent in AGENTS:
        for number in range(chance.randint(1, 3)):
            node = NodeState(
                f"{agent.name}-{number}",
                agent.name,
                agent.role,
                frozenset(chance.sample(["gpu", "disk"], chance.randint(0, 2))),
                True,
                cordoned=chance.random() < 0.1,
                allocatable=Resources(chance.choice([500, 1000, 1500]), 2**30),
                created=number,
            )
            nodes.append(lost(node) if chance.random() < 0.2 else node)
    return nodes


def check(desired: Composition, nodes: Sequence[NodeState], needs: Mapping[str, int]) -> None:
    """What must hold whatever happened: groups and their bridges are on one Node, and no Node is overbooked."""
    by_name = {node.name: node for node in nodes}
    several_nodes = {a.name for a in AGENTS if sum(node.agent == a.name for node in nodes) > 1}
    used: dict[str, int] = {}
    bridges = {
        (r.values["placement"]["agent"], r.values["placement"].get("node", "")): r.values["bridge"]
        for r in desired.releases.values()
        if "bridge" in r.values
    }
    for key, outcome in desired.outcomes.items():
        if not isinstance(outcome, Met):
            continue
        mine = [r for r in desired.releases.values() if r.name.endswith(key.rpartition("/")[2]) and "x" in r.values]
        spots = {(r.values["placement"]["agent"], r.values["placement"].get("node", "")) for r in mine}
        assert len(spots) == 1, (key, spots)
        agent, node = spots.pop()
        assert (node != "") == (agent in several_nodes)
        assert node == "" or by_name[node].agent == agent
        assert any(topic["name"] == f"/vehicles/{ros_name(agent)}/pose" for topic in bridges[agent, node]["out"])
    for release in desired.releases.values():
        placed = release.values["placement"]
        node = placed.get("node") or next(n.name for n in nodes if n.agent == placed["agent"])
        used[node] = used.get(node, 0) + needs.get(release.chart, 0)
    for name, millicores in used.items():
        room = by_name[name].allocatable
        assert room is not None
        assert millicores <= room.cpu_millicores, name


@pytest.mark.parametrize("seed", range(EXAMPLES))
def test_groups_bridges_and_room_in_any_fleet(seed: int) -> None:
    chance = random.Random(seed)  # noqa: S311 - a case is named by its number
    services = [{**service, "values": {"x": 1}} for service in PAIR]
    light = chart("light", resources={"cpu": "50m", "memory": "64Mi"})
    bridge = application(
        {
            "name": "bridge",
            "release": "mqtt-bridge",
            "chart": {"name": "light", "version": ">=0.1.0"},
            "placement": {"agent": "{{ agent }}"},
            "values": {"bridge": {"out": "{{ topics.out }}", "in": "{{ topics['in'] }}"}},
        },
        name="bridge",
        word="link/mqtt",
    )
    known = catalogue(
        application(*services, links=[ROS, TO_CLOUD]), bridge, chart(resources={"cpu": "200m", "memory": "64Mi"}), light
    )
    memo = Memo()
    present = dict[str, Release]()
    asked: list[Demand] = several(chance.randint(1, 6))
    for _ in range(4):
        nodes = machines(chance)
        around = Inputs(known, fleet(AGENTS, nodes, 50 * SECOND), {}, RENDER, validate)
        check(compose(asked, around), nodes, {"worker": 200, "light": 50})
        again = replace(around, present=present)
        desired = compose(asked, again, memo)
        assert desired == compose(asked, again)
        after = compose(asked, replace(around, present=standing(desired)), memo)
        assert spots(after) == spots(desired)  # nothing moves by itself
        present = standing(after)
        assert compose(asked, replace(around, present=present), memo).releases == after.releases
        asked = [one for one in asked if chance.random() < 0.8] or asked
