"""A node is lost while the manager runs: what is not bound to it goes elsewhere, by a commit that says why."""

from __future__ import annotations

from dataclasses import replace

from robotkube.delivery.manager.core.observation import PodState
from robotkube.delivery.manager.core.placement.placement import Agent, NodeState
from robotkube.delivery.manager.loops.reconciler import APPLICATIONS, NODES
from tests.stages.delivery.manager.manager_in_memory import MEETING, START_NS, Stage

RECORDER = "recorder-vehicle-00-vehicle-01"


def two_clouds(stage: Stage) -> None:
    """Another cloud that can record; the recorder of the meeting runs on one of both."""
    stage.settings = replace(stage.settings, agents=(*stage.settings.agents, Agent("cloud-1", "cloud", "cloud-1")))
    stage.cluster.machines.append(NodeState("cloud-1", "cloud-1", "cloud", frozenset({"recording"}), True))
    stage.manager = stage.start()
    stage.settle()
    stage.ask()
    stage.settle()
    assert stage.tasks.condition(MEETING, "Ready") == ("True", "Observed")


def place(stage: Stage) -> str:
    """The agent that records."""
    namespaces = [release.namespace for release in stage.releases().values() if release.name == RECORDER]
    assert len(namespaces) == 1
    return namespaces[0]


def silence(stage: Stage, agent: str) -> None:
    """Nothing is heard of an agent's node any more."""
    since = START_NS + int(stage.seconds * 1e9)
    stage.cluster.machines = [
        replace(n, ready=False, not_ready_since=since, silent_since=since) if n.agent == agent else n
        for n in stage.cluster.machines
    ]
    stage.go(wake=NODES)


def last_message(stage: Stage) -> str:
    """The text of main's last commit."""
    return stage.repository.log(None, 1)[-1].message


def test_a_recorder_leaves_a_lost_node_and_nothing_leaves_before(stage: Stage) -> None:
    two_clouds(stage)
    first = place(stage)
    other = "cloud-1" if first == "cloud-0" else "cloud-0"
    silence(stage, first)
    stage.seconds += 30
    stage.go(wake=NODES)
    assert place(stage) == first
    stage.seconds += 12  # nothing is reported at that moment: the manager plans by itself
    for _ in range(6):
        stage.manager.step()
        stage.seconds += 0.1
    assert place(stage) == other
    text = last_message(stage)
    assert text.startswith(f"deploy(node): node {first} lost for 4")
    assert f"{RECORDER} moved to {other}" in text.splitlines()[0]
    assert "RobotKube-Cause: node" in text
    assert f"RobotKube-Task: {MEETING}" in text


def test_an_old_pod_on_the_dead_node_holds_nobody_up_and_is_named_until_it_is_gone(stage: Stage) -> None:
    two_clouds(stage)
    first = place(stage)
    silence(stage, first)
    stage.seconds += 50
    stage.go(wake=NODES)
    old = PodState(first, "old-pod", f"{first}/{RECORDER}", first, deleting=True, node_silent_seconds=51.0)
    stage.cluster.settle(stage.releases())
    stage.cluster.running[old.release] = [old]
    stage.go(wake=APPLICATIONS)
    assert stage.tasks.condition(MEETING, "Ready") == ("True", "OldPodUnreachable")
    stage.cluster.running[old.release] = [replace(old, node_gone=True)]
    stage.go(wake=APPLICATIONS)
    assert stage.tasks.condition(MEETING, "Ready") == ("True", "Observed")


def test_it_stays_where_it_is_when_the_node_is_back(stage: Stage) -> None:
    two_clouds(stage)
    first = place(stage)
    silence(stage, first)
    stage.seconds += 50
    stage.go(wake=NODES)
    moved = place(stage)
    assert moved != first
    stage.cluster.machines = [
        replace(n, ready=True, not_ready_since=None, silent_since=None) for n in stage.cluster.machines
    ]
    stage.settle()
    tip = stage.repository.tip
    stage.go(wake=NODES)
    assert (place(stage), stage.repository.tip) == (moved, tip)


def test_without_another_place_it_waits(stage: Stage) -> None:
    stage.settle()
    stage.ask()
    stage.settle()
    tip = stage.repository.tip
    silence(stage, "cloud-0")
    stage.seconds += 50
    stage.go(wake=NODES)
    assert (place(stage), stage.repository.tip) == ("cloud-0", tip)
    assert stage.tasks.condition(MEETING, "Accepted") == ("True", "Accepted")
