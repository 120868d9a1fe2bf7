"""Scopes of managers and operators: what is outside is refused, and a narrower scope is never more than the wider."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.placement.placement import Agent, NodeState, fleet
from robotkube.delivery.manager.core.placement.scopes import (
    ALL,
    EVERYTHING,
    DeclaredManager,
    Operators,
    Scope,
    check_application,
    check_releases,
    excesses,
    left_out,
    overlaps,
    own_releases,
    scoped_fleet,
    split_agents,
    unknown_nodes,
)
from robotkube.errors import RefusalError

AGENTS = tuple(
    Agent(name, role, name) for name, role in (("cloud-0", "cloud"), ("rsu-0", "roadside"), ("v-0", "vehicle"))
)
NODES = tuple(NodeState(f"n-{a.name}", a.name, a.role, frozenset(), True) for a in AGENTS)
NAMES = ("cloud-0", "rsu-0", "v-0")
ROAD = Scope(frozenset({"rsu-0"}), frozenset({"rsu-0"}), EVERYTHING)

names = st.one_of(st.just(EVERYTHING), st.frozensets(st.sampled_from(NAMES)))
scopes = st.builds(Scope, names, names, names)


def release(namespace: str, **fields: Any) -> Release:
    return Release(namespace, "r", "chart", "1.0.0", "sha256:" + "0" * 64, {}, **fields)


@given(scopes, scopes)
def test_what_is_in_both_is_a_subset_of_each(one: Scope, other: Scope) -> None:
    both = one.narrowed(other)
    assert both.subset(one)
    assert both.subset(other)
    for name in NAMES:
        assert both.covers_agent(name) == (one.covers_agent(name) and other.covers_agent(name))


@given(scopes, scopes)
def test_a_subset_covers_nothing_else(one: Scope, other: Scope) -> None:
    if one.subset(other):
        assert all(other.covers_agent(name) for name in NAMES if one.covers_agent(name))
        assert all(other.covers_application(name) for name in NAMES if one.covers_application(name))
        assert ALL not in one.agents or ALL in other.agents


@given(st.lists(scopes, max_size=4))
def test_managers_overlap_when_two_cover_one_name(scopes: list[Scope]) -> None:
    managers = [DeclaredManager(f"m-{index}", scope) for index, scope in enumerate(scopes)]
    pairs = [(one, other) for index, one in enumerate(managers) for other in managers[index + 1 :]]
    shared = [
        (one.name, other.name, key)
        for one, other in pairs
        for key, covers in (("agents", Scope.covers_agent), ("namespaces", Scope.covers_namespace))
        if any(covers(one.scope, name) and covers(other.scope, name) for name in NAMES)
    ]
    problems = overlaps(managers)
    assert len(problems) == len(shared)
    for (one, other, key), problem in zip(shared, problems, strict=True):
        assert problem.startswith(f"managers {one!r} and {other!r} both have ")
        assert f"in scope.{key}: " in problem
        assert "name each in one manager only" in problem


def test_an_agent_that_no_manager_has_is_named_with_those_that_could_take_it() -> None:
    road = DeclaredManager("road", ROAD)
    [cloud, vehicle] = left_out([road], NAMES)
    assert cloud.startswith("agent 'cloud-0' is in no manager's scope, so nothing would ever run on it; add it to ")
    assert "of one of road (charts/robotkube, values managers)" in vehicle
    assert left_out([road, DeclaredManager("rest", Scope())], NAMES) == []


def test_an_agent_and_its_namespace_have_one_manager() -> None:
    assert split_agents(ROAD, NAMES) == []
    [problem] = split_agents(Scope(frozenset({"rsu-0", "people"}), frozenset({"rsu-0", "v-0"})), NAMES)
    assert problem.startswith("'v-0' is in scope.agents, but not in scope.namespaces")
    assert len(split_agents(Scope(agents=frozenset({"rsu-0"})), NAMES)) == 2


def test_an_operator_is_its_managers_and_never_more_than_it() -> None:
    assert excesses(ROAD, {"rsu-0": {"agents": frozenset({"rsu-0"}), "applications": EVERYTHING}}) == []
    problems = excesses(ROAD, {"v-0": {"agents": frozenset({"v-0", "rsu-0"})}, "rsu-0": {"agents": EVERYTHING}})
    assert [problem.partition(":")[0] for problem in problems] == [
        "operator 'v-0' is not in scope.namespaces",
        "operator 'v-0' has v-0 in agents, more than its manager's scope.agents",
        "operator 'rsu-0' has * in agents, more than its manager's scope.agents",
    ]


@given(scopes, st.dictionaries(st.sampled_from(NAMES), scopes), st.lists(st.sampled_from(NAMES), max_size=5))
def test_an_operator_in_a_chain_never_has_more_than_those_before_it(
    manager: Scope, declared: dict[str, Scope], chain: list[str]
) -> None:
    operators = Operators(manager, declared)
    assert operators.scope(()) == manager
    for index in range(len(chain)):
        assert operators.scope(chain[index:]).subset(operators.scope(chain[index + 1 :]))


def test_an_agent_of_another_scope_is_refused_by_name() -> None:
    scoped = scoped_fleet(fleet(AGENTS, NODES), ROAD)
    assert scoped.agent("rsu-0").name == "rsu-0"
    assert scoped.present("vehicle") == ()
    with pytest.raises(RefusalError, match="agent 'v-0' belongs to another scope; this one holds rsu-0") as caught:
        scoped.agent("v-0")
    assert caught.value.reason == "OutsideScope"
    with pytest.raises(RefusalError) as caught:
        scoped.agent("nobody")
    assert caught.value.reason == "NoCapableNode"


def test_a_scope_of_everything_leaves_the_fleet_as_it_is() -> None:
    whole = fleet(AGENTS, NODES)
    assert scoped_fleet(whole, Scope()) is whole


def test_a_manager_answers_for_releases_on_its_agents_only() -> None:
    main = {f"releases/{name}/r.yaml": release(name) for name in ("cloud-0", "rsu-0", "gone-0")}
    assert {r.namespace for r in own_releases(main, AGENTS, ROAD).values()} == {"rsu-0"}
    assert {r.namespace for r in own_releases(main, AGENTS, Scope()).values()} == {"cloud-0", "rsu-0", "gone-0"}


def test_an_application_outside_the_scope_is_refused_with_the_way_in() -> None:
    scope = Scope(applications=frozenset({"recording"}))
    check_application(scope, "v-0/t", "recording")
    with pytest.raises(
        RefusalError, match="may not ask for application 'platooning': its operator may launch recording"
    ):
        check_application(scope, "v-0/t", "platooning")


def test_releases_outside_the_scope_are_refused_with_the_agents() -> None:
    check_releases(ROAD, "rsu-0/t", ["rsu-0"])
    with pytest.raises(
        RefusalError, match="task rsu-0/t leads to releases on cloud-0, v-0: its operator may touch rsu-0"
    ):
        check_releases(ROAD, "rsu-0/t", ["v-0", "rsu-0", "cloud-0"])


def test_nodes_of_undeclared_agents_are_found() -> None:
    stranger = NodeState("n-9", "v-9", "vehicle", frozenset(), True)
    machine = NodeState("platform-0", "platform-0", "platform", frozenset(), True)
    assert unknown_nodes((stranger, machine, *NODES), NAMES) == (stranger,)
