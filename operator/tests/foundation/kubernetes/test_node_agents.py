"""Whose a Node is by its labels: one agent's, or a host's and guests'."""

from __future__ import annotations

import random

import pytest

from robotkube.foundation.kubernetes.core.node_agents import (
    GUESTS_MAX,
    NodeAgent,
    node_agents,
    shared_nodes,
    trial_words,
)

HOST = NodeAgent("vehicle-00", "vehicle", frozenset({"lidar", "recording"}))


def test_a_node_of_one_agent_and_one_of_nobody() -> None:
    assert node_agents(HOST.labels) == (HOST,)
    assert node_agents({"robotkube.io/capability.lidar": "false"}) == (NodeAgent("", ""),)


@pytest.mark.parametrize("seed", range(20))
def test_labels_say_again_who_made_them(seed: int) -> None:
    choose = random.Random(seed)  # noqa: S311 - a case is named by its number
    roles, capabilities = ("vehicle", "cloud", "platform"), ("lidar", "gpu", "recording")
    guests = tuple(
        NodeAgent(f"a-{number}", choose.choice(roles), frozenset(choose.sample(capabilities, 2)), number)
        for number in range(1, choose.randint(2, 9))
    )
    labels = [pair for one in (HOST, *guests) for pair in one.labels.items()]
    choose.shuffle(labels)
    assert node_agents(dict(labels)) == (HOST, *guests)
    assert len(dict(labels)) == len(labels), "no two of them have one label"


@pytest.mark.parametrize("word", ["", "0", "-1", "x", "1.5", "٣", str(GUESTS_MAX + 1)])
def test_a_number_that_can_be_no_guests_makes_none(word: str) -> None:
    assert node_agents({**HOST.labels, "agent.robotkube.io/vehicle-01": word}) == (HOST,)


def test_the_longest_name_makes_labels_that_kubernetes_takes() -> None:
    longest = NodeAgent("a" * 40, "b" * 40, frozenset({"c" * 40}), GUESTS_MAX)
    for key in longest.labels:
        prefix, _, name = key.partition("/")
        assert len(prefix) <= 253
        assert len(name) <= 63


def test_what_is_said_names_nodes_and_agents() -> None:
    guest = NodeAgent("vehicle-01", "vehicle", frozenset(), 1)
    nodes = [("worker-2", HOST.labels | guest.labels), ("worker-1", HOST.labels)]
    assert shared_nodes(nodes) == {"worker-2": ["vehicle-00", "vehicle-01"]}
    assert trial_words(shared_nodes(nodes)) == (
        "trial mode: agents share Nodes (Node worker-2 is vehicle-00, vehicle-01), so no machine keeps them apart, and "
        "no figure compares machines"
    )
    assert trial_words({}) == ""
