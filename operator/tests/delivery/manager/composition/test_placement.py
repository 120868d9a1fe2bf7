"""Places of services: room, distance, what a task says, lost nodes; and what they share there."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.composition.composer import Refused, compose
from robotkube.delivery.manager.core.composition.release_merge import merged_release
from robotkube.delivery.manager.core.placement.capacity import Resources
from robotkube.delivery.manager.core.placement.placement import Agent, NodeState, fleet, next_loss_ns
from robotkube.delivery.manager.core.plans import differences, lost_node_text
from robotkube.delivery.tasks.core.task_description import TaskPlacement
from tests.stages.delivery.manager.placement import (
    NODES,
    ONE,
    PLAIN,
    ROOM,
    SECOND,
    application,
    catalogue,
    choices,
    demand,
    inputs,
    places,
    refusal,
    several,
    task,
)

# -- room -------------------------------------------------------------------------------------------------------------


def test_a_node_takes_what_fits_and_the_rest_is_refused_with_every_reason() -> None:
    composition = compose(several(7), inputs())
    assert sorted(r.namespace for r in composition.releases.values()) == sorted(
        ["roadside-0", "roadside-1", "roadside-2"] * 2
    )
    outcome = refusal(composition, "ops/t6")
    assert outcome.reason == "InsufficientResources"
    assert (
        "no agent for role roadside has room: roadside-0: has not enough room: cpu 500m of 0m free;" in outcome.message
    )
    assert outcome.message.endswith("ask for less, or withdraw something that runs there")


def test_memory_counts_as_well_and_nobody_knows_of_a_node_without_numbers() -> None:
    small = [replace(node, allocatable=Resources(4000, 300 * 2**20)) for node in NODES]
    composition = compose(several(4), inputs(nodes=small))
    assert refusal(composition, "ops/t3").message.count("memory 256Mi of 44Mi free") == 3
    unknown = [replace(node, allocatable=None) for node in NODES]
    assert len(places(compose(several(40), inputs(nodes=unknown)))) == 40


def test_releases_of_others_take_room() -> None:
    mine = compose(several(6), inputs()).releases
    composition = compose([demand(task())], inputs(others=mine))
    assert refusal(composition).reason == "InsufficientResources"
    assert composition.releases == {}
    unknown = {path: replace(release, chart="stranger") for path, release in mine.items()}
    assert places(compose([demand(task())], inputs(others=unknown))) == {"a-t": "roadside-0"}


def test_what_runs_keeps_its_place_before_anything_new_even_when_there_is_too_little_room() -> None:
    before = compose(several(6), inputs())
    small = [replace(node, allocatable=Resources(400, 2**30)) for node in NODES]
    after = compose([*several(6), demand(task())], inputs(nodes=small, present=before.releases))
    assert after.releases == before.releases
    assert refusal(after).reason == "InsufficientResources"


def test_a_group_needs_room_for_all_of_it_on_one_node() -> None:
    linked = [{"kind": "ros", "from": {"service": "a"}, "to": {"service": "b"}}]
    pair = catalogue(application(ONE, {**ONE, "name": "b", "release": "b-{{ task.name }}"}, links=linked))
    composition = compose(several(4), inputs(pair))
    assert {r.name: r.namespace for r in composition.releases.values()} == {
        f"{letter}-t{number}": f"roadside-{number}" for number in range(3) for letter in "ab"
    }
    assert "(a, b: on one node, linked by ros) has room" in refusal(composition, "ops/t3").message


def test_a_pod_must_fit_on_one_of_the_nodes_of_an_agent() -> None:
    twins = [replace(NODES[0], name=f"n{i}", allocatable=Resources(600, 2**30)) for i in range(2)]
    composition = compose(several(3), inputs(nodes=twins))
    assert places(replace(composition, outcomes={})) == {"a-t0": "roadside-0", "a-t1": "roadside-0"}
    thin = [replace(node, allocatable=Resources(400, 2**30)) for node in twins]
    message = refusal(compose([demand(task())], inputs(nodes=thin))).message
    assert "roadside-0 (Node n0): has not enough room: cpu 500m of 400m free" in message


def test_a_named_agent_needs_room_too_and_so_does_its_bridge() -> None:
    named = catalogue(application({**ONE, "placement": {"agent": "roadside-1"}}))
    outcome = refusal(compose(several(3), inputs(named)), "ops/t2")
    assert outcome.reason == "InsufficientResources"
    assert "roadside-1: has not enough room" in outcome.message
    topic = {
        "name": "/vehicles/{{ placement.a | ros }}/t",
        "type": "std_msgs/msg/String",
        "channel": "telemetry",
        "reliability": "reliable",
        "durability": "volatile",
        "depth": 1,
    }
    link = {"kind": "mqtt", "from": {"service": "a"}, "to": {"agent": "cloud-0"}, "topics": [topic]}
    bridge = application(
        {"name": "b", "release": "bridge", "placement": {"agent": "{{ agent }}"}}, name="bridge", word="link/mqtt"
    )
    linked = catalogue(application(ONE, links=[link]), bridge)
    full = [replace(node, allocatable=Resources(900, 2**30)) for node in NODES]
    composition = compose([demand(task())], inputs(linked, full))
    assert refusal(composition).reason == "InsufficientResources"
    assert "roadside-0 has no room for its bridge (cpu 500m of 400m free)" in refusal(composition).message
    assert composition.releases == {}
    assert places(compose([demand(task())], inputs(linked)))["bridge"] in ("cloud-0", "roadside-0")


# -- what a task says -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("placement", "agent", "text"),
    [
        (TaskPlacement(agents=("roadside-2",)), "roadside-2", ""),
        (TaskPlacement(roles=("roadside",)), "roadside-0", ""),
        (TaskPlacement(agents=("cloud-0",)), "", "one of the agents cloud-0: cloud-0: has role cloud, not roadside"),
        (
            TaskPlacement(agents=("roadside-9",)),
            "",
            "service a of application app: no agent for role roadside, one of the agents roadside-9: no such agent is "
            "declared (values `agents` of the chart robotkube)",
        ),
        (TaskPlacement(roles=("cloud",)), "", "roadside-0: has role roadside, the task wants cloud"),
        (TaskPlacement(capabilities=("arm",)), "", "roadside-2: lacks capability arm"),
    ],
)  # fmt: skip
def test_a_task_narrows_the_rule_and_never_widens_it(placement: TaskPlacement, agent: str, text: str) -> None:
    composition = compose([demand(task(placement=placement))], inputs())
    if agent:
        assert places(composition) == {"a-t": agent}
    else:
        assert refusal(composition).reason == "NoCapableNode"
        assert text in refusal(composition).message


def test_a_service_on_an_agent_that_nobody_declared_is_named() -> None:
    named = catalogue(application({**ONE, "placement": {"agent": "roadside-9"}}))
    assert refusal(compose([demand(task())], inputs(named))) == Refused(
        "NoCapableNode",
        "service a of application app: agent 'roadside-9' is not declared; name one that is (cloud-0, roadside-0, "
        "roadside-1, roadside-2), or declare it (values `agents` of the chart robotkube)",
    )


def test_a_demand_that_is_offloaded_goes_to_other_roles_with_the_same_capabilities() -> None:
    assert places(compose([demand(task(), roles=("cloud",))], inputs())) == {"a-t": "cloud-0"}
    needs = catalogue(application({**ONE, "placement": {"role": "roadside", "capabilities": ["gpu"]}}))
    bare = [replace(node, capabilities=frozenset()) for node in NODES]
    composition = compose([demand(task(), roles=("cloud",))], inputs(needs, bare))
    assert "one of the roles cloud, capability gpu: cloud-0: lacks capability gpu" in refusal(composition).message


def test_tasks_keep_away_from_others_in_both_directions() -> None:
    first, away = (
        task("t0"),
        task("t1", placement=TaskPlacement(agents=("roadside-0", "roadside-1"), anti_affinity=("t0",))),
    )
    assert places(compose([demand(first), demand(away)], inputs())) == {"a-t0": "roadside-0", "a-t1": "roadside-1"}
    late = task("t0", placement=TaskPlacement(agents=("roadside-0",)))
    backward = compose(
        [demand(replace(away, placement=replace(away.placement, agents=("roadside-0",)))), demand(late)], inputs()
    )
    assert "roadside-0: runs what keeps away from ops/t0" in refusal(backward, "ops/t0").message
    only = replace(away, placement=TaskPlacement(agents=("roadside-0",), anti_affinity=("a-t0",)))
    assert (
        "roadside-0: runs a-t0, which the task keeps away from"
        in refusal(compose([demand(first), demand(only)], inputs()), "ops/t1").message
    )
    placed = compose([demand(first)], inputs()).releases
    assert refusal(compose([demand(only)], inputs(others=placed)), "ops/t1").reason == "NoCapableNode"


def test_instances_of_a_service_are_spread_where_the_application_asks_for_it() -> None:
    spread = catalogue(application({**ONE, "placement": {"role": "roadside", "spread": True}}))
    composition = compose(several(4), inputs(spread))
    assert sorted(r.namespace for r in composition.releases.values()) == ["roadside-0", "roadside-1", "roadside-2"]
    assert refusal(composition, "ops/t3").reason == "NoCapableNode"
    assert "roadside-1: runs another instance, and instances are spread" in refusal(composition, "ops/t3").message


# -- nodes that go ----------------------------------------------------------------------------------------------------


def test_a_service_leaves_a_lost_node_and_the_commit_says_why() -> None:
    before = compose([demand(task())], inputs()).releases
    gone = [replace(NODES[0], ready=False, not_ready_since=0, silent_since=0), *NODES[1:]]
    waiting = inputs(nodes=gone, now=40, present=before)
    assert compose([demand(task())], waiting).releases == before
    assert next_loss_ns(gone, 40.0, 30 * SECOND) == 40 * SECOND + 1
    lost = inputs(nodes=gone, now=41, present=before)
    after = compose([demand(task())], lost)
    assert places(after) == {"a-t": "roadside-1"}
    assert "roadside-0: its Node is lost: roadside-0" in choices(after)
    changes = differences(after.releases, before)
    assert lost_node_text(changes, lost.fleet, 41 * SECOND) == "node roadside-0 lost for 41 s: a-t moved to roadside-1"
    assert next_loss_ns(gone, 40.0, 41 * SECOND) is None
    back = inputs(present=after.releases)
    assert compose([demand(task())], back).releases == after.releases  # it does not move again
    assert lost_node_text(differences(after.releases, before), back.fleet, 0) == ""


def test_a_service_whose_node_was_deleted_moves_at_once() -> None:
    before = compose([demand(task())], inputs()).releases
    without = inputs(nodes=NODES[1:], present=before)
    after = compose([demand(task())], without)
    assert places(after) == {"a-t": "roadside-1"}
    assert (
        lost_node_text(differences(after.releases, before), without.fleet, 0)
        == "agent roadside-0 has no node: a-t moved to roadside-1"
    )


def test_bound_services_wait_for_their_agent_and_others_when_nobody_else_can_take_them() -> None:
    lost = [replace(node, ready=False, not_ready_since=0) for node in NODES]
    named = catalogue(application({**ONE, "placement": {"agent": "roadside-1"}}))
    assert places(compose([demand(task())], inputs(named, lost, now=99))) == {"a-t": "roadside-1"}
    before = compose([demand(task())], inputs()).releases
    stays = compose([demand(task())], inputs(nodes=lost, now=99, present=before))
    assert stays.releases == before
    assert "roadside-0: its Node is lost, and nobody else can take it: it waits" in choices(stays)
    elsewhere = compose([demand(task(conflict_policy="Offload"))], inputs(nodes=lost, now=99, present=before))
    assert refusal(elsewhere).reason == "NoCapableNode"
    assert refusal(compose([demand(task())], inputs(nodes=lost, now=99))).reason == "NoCapableNode"


def test_a_cordoned_node_keeps_what_it_has_and_takes_nothing_new() -> None:
    before = compose([demand(task())], inputs()).releases
    cordoned = [replace(NODES[0], cordoned=True), *NODES[1:]]
    composition = compose([demand(task()), demand(task("u"))], inputs(nodes=cordoned, present=before))
    assert places(composition) == {"a-t": "roadside-0", "a-u": "roadside-1"}


def test_one_of_two_nodes_is_enough_for_an_agent() -> None:
    twins = [replace(NODES[0], name="old", ready=False, not_ready_since=0), replace(NODES[0], name="new")]
    one_lost = inputs(nodes=twins, now=99)
    assert places(compose([demand(task())], one_lost)) == {"a-t": "roadside-0"}
    assert one_lost.fleet.loss("roadside-0", 99 * SECOND) == ""
    assert one_lost.fleet.capacities["roadside-0"].total == ROOM  # a lost node gives no room


# -- values and shared releases ---------------------------------------------------------------------------------------


def test_values_that_break_the_charts_schema_are_refused_before_anything_is_written() -> None:
    service = {**ONE, "values": {"rate": "{{ task.name }}", "odd": 1}}
    schema = {
        "type": "object",
        "additionalProperties": False,
        "properties": {"rate": {"type": "number"}, "placement": {}, "global": {}},
    }
    composition = compose(
        [demand(task())], inputs(catalogue(application(service)), schema=lambda chart, version: schema)
    )
    assert refusal(composition).reason == "CompositionFailed"
    assert (
        "chart worker 0.1.0: values: Additional properties are not allowed ('odd' was unexpected)"
        in refusal(composition).message
    )
    assert "values.rate: 't' is not of type 'number'" in refusal(composition).message
    assert composition.releases == {}


def test_without_a_schema_nothing_verified_is_written() -> None:
    version = replace(
        PLAIN.charts["worker"][0], state="verified", evidence="sha256:" + "e" * 64, assured=True, evidence_problem=""
    )
    strict = replace(PLAIN, charts={"worker": (version,)}, assurance="verified")
    composition = compose([demand(task())], inputs(strict, schema=lambda chart, version: None))
    assert (
        "has no charts/worker/0.1.0.schema.json to check the values by; submit the chart again"
        in refusal(composition).message
    )
    assert places(compose([demand(task())], inputs(schema=lambda chart, version: None))) == {"a-t": "roadside-0"}


def test_demands_share_a_release_by_uniting_the_lists_that_may_be_united() -> None:
    shared = {**ONE, "release": "shared", "values": {"topics": ["{{ task.name }}", "both"], "depth": 1}}
    two = several(2)
    composition = compose(two, inputs(catalogue(application({**shared, "unite": ["topics"]}))))
    release = next(iter(composition.releases.values()))
    assert len(composition.releases) == 1
    assert release.values["topics"] == ["both", "t0", "t1"]
    assert [cause.task for cause in release.causes] == ["ops/t0", "ops/t1"]
    apart = catalogue(application({**shared, "placement": {"agent": "roadside-0"}}))
    outcome = refusal(compose([demand(task("t0")), demand(task("t1"))], inputs(apart)), "ops/t1")
    assert outcome.reason == "ReleaseInUse"
    said = "release roadside-0/shared is made for task ops/t0 (application app) with other content (values.topics); "
    assert outcome.message.startswith(f"{said}withdraw that, or")


@pytest.mark.parametrize(
    ("first", "second", "both"),
    [
        ({"a": {"x": [1, 2]}}, {"a": {"x": [2, 3]}}, {"a": {"x": [1, 2, 3]}}),
        ({"a": {"x": [{"k": 1}]}, "b": None}, {"a": {"x": []}, "b": None}, {"a": {"x": [{"k": 1}]}, "b": None}),
        ({"a": {"x": [1]}, "b": None}, {"a": {"x": [1]}, "b": 5}, None),
        ({"a": {"x": [1]}, "b": [1]}, {"a": {"x": [1]}, "b": [2]}, None),
        ({"a": {"x": [1]}}, {"a": {"x": 1}}, None),
        ({"a": {"x": [1]}}, {"a": {"x": [1], "y": 1}}, None),
    ],
)
def test_what_can_be_united(first: dict[str, Any], second: dict[str, Any], both: dict[str, Any] | None) -> None:
    one, two = (Release("n", "r", "c", "0.1.0", "d", values) for values in (first, second))
    for left, right in ((one, two), (two, one)):
        merged = merged_release(left, right, ["a.x"])
        assert (merged and merged.values) == both
    assert merged_release(one, replace(two, version="0.2.0"), ["a.x"]) is None
    assert merged_release(one, two, []) is None


def test_a_release_that_is_shared_asks_for_room_once() -> None:
    shared = {**ONE, "release": "shared", "values": {"topics": ["{{ task.name }}"]}, "unite": ["topics"]}
    wanted = several(9)
    composition = compose(wanted, inputs(catalogue(application(shared))))
    assert places(composition) == {"shared": "roadside-0"}
    assert len(next(iter(composition.releases.values())).values["topics"]) == 9


# -- many -------------------------------------------------------------------------------------------------------------


def test_the_reasons_of_many_candidates_are_counted() -> None:
    agents = [Agent(f"site-{i:04d}", "roadside", f"site-{i:04d}") for i in range(1000)]
    nodes = [
        NodeState(a.name, a.name, a.role, frozenset(), i % 2 == 0, allocatable=ROOM) for i, a in enumerate(agents[:900])
    ]
    crowd = replace(inputs(), fleet=fleet(agents, nodes))
    text = "; ".join(choices(compose([demand(task())], crowd)))
    assert "449 agents (site-0002, site-0004, site-0006, site-0008, site-0010, ...): possible" in text
    assert (
        "450 agents (site-0001, site-0003, site-0005, site-0007, site-0009, ...): no Node is Ready and schedulable"
        in text
    )
    asked = task(placement=TaskPlacement(capabilities=("arm",)))
    message = refusal(compose([demand(asked)], crowd)).message
    assert "900 agents (site-0000, site-0001, site-0002, site-0003, site-0004, ...): lacks capability arm" in message
    assert "100 agents (site-0900, site-0901, site-0902, site-0903, site-0904, ...): has no Node" in message
    assert len(message) < 500


def test_release_files_of_others_are_never_composed() -> None:
    stranger = Release("roadside-0", "stranger", "worker", "0.1.0", "sha256:" + "0" * 64, {})
    composition = compose([demand(task())], inputs(others={stranger.path: stranger}))
    assert places(composition) == {"a-t": "roadside-1"}  # the emptiest
