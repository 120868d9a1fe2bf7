"""Address plans: two clusters never meet, and no two nodes of one share an address."""

from __future__ import annotations

from itertools import combinations

import pytest

from ci.cluster.embedded.network.addresses import PLANS, plan_of
from ci.cluster_contract.topology import NODES_MAX
from ci.errors import InputError


def test_no_ranges_overlap() -> None:
    ranges = [network for plan in PLANS.values() for network in (plan.nodes, plan.pods, plan.services)]
    assert not any(one.overlaps(other) for one, other in combinations(ranges, 2))


@pytest.mark.parametrize("name", sorted(PLANS))
def test_every_node_has_its_own_addresses(name: str) -> None:
    plan = plan_of(name)
    addresses = {plan.node(index) for index in range(NODES_MAX)}
    subnets = {plan.pod_subnet(index) for index in range(NODES_MAX)}
    assert len(addresses) == len(subnets) == NODES_MAX
    assert plan.gateway not in addresses
    assert all(address in plan.nodes for address in addresses)


def test_the_contract_of_the_demo() -> None:
    plan = plan_of("demo")
    assert (plan.bridge, str(plan.gateway), str(plan.node(0))) == ("rk-demo", "10.89.0.1", "10.89.0.10")
    assert (str(plan.pod_subnet(2)), str(plan.kubernetes_service)) == ("10.244.2.0/24", "10.96.0.1")


@pytest.mark.parametrize("name", sorted(PLANS))
def test_link_names_fit_the_kernels_bound(name: str) -> None:
    assert len(plan_of(name).link(NODES_MAX - 1)) <= 15


@pytest.mark.parametrize("name", sorted(PLANS))
def test_a_node_is_known_by_its_address(name: str) -> None:
    plan = plan_of(name)
    assert [plan.index(str(plan.node(index))) for index in range(NODES_MAX)] == [*range(NODES_MAX)]


def test_bridges_have_addresses_of_their_own() -> None:
    """Locally administered, of one machine: the first byte's two lowest bits are 1 and 0."""
    addresses = {plan.hardware_address for plan in PLANS.values()}
    assert len(addresses) == len(PLANS)
    assert all(int(address[:2], 16) & 3 == 2 for address in addresses)


def test_unknown_cluster_and_node_are_refused() -> None:
    with pytest.raises(InputError, match="choose one of demo, test"):
        plan_of("other")
    with pytest.raises(InputError, match="outside 0 to"):
        plan_of("demo").node(NODES_MAX)
