"""Nodes of a cluster that is there: which become whose, what is added to them, and that exactly this goes again."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import pytest
import yaml

from ci.cluster.api_server import node_states
from ci.cluster.existing import mapping, registry
from ci.cluster.existing.labels import ADDED, GivenNode, NodeChange, adding, removing, wanted_labels
from ci.cluster.existing.mapping import AgentEntry, AgentsFile
from ci.cluster_contract import sharing
from ci.cluster_contract.topology import chart_agents
from ci.errors import InputError, SetUpError
from ci.images.image_lock import Image
from robotkube.foundation.kubernetes.core.node_agents import GUESTS_MAX, node_agents

AGENT, ROLE = "robotkube.io/agent", "robotkube.io/role"
PLATFORM = AgentEntry("worker-1", (), "platform", "platform")
ROBOTS = AgentEntry("", (("pool", "robots"),), "vehicle", "vehicle-00", ("lidar",))
BOTH = AgentsFile((PLATFORM, ROBOTS))
SECOND = AgentEntry("worker-2", (), "vehicle", "vehicle-01", ("lidar", "recording"))
CLOUD = AgentEntry("worker-1", (), "cloud", "cloud-0", ("recording",))
TRIAL = AgentsFile((PLATFORM, CLOUD, ROBOTS, SECOND), trial=True)
NODES = (
    GivenNode("control-plane", {"kubernetes.io/hostname": "control-plane"}),
    GivenNode("worker-1", {"kubernetes.io/hostname": "worker-1"}, {"theirs": "x"}),
    GivenNode("worker-2", {"pool": "robots"}),
)


def written(nodes: Sequence[GivenNode], changes: Sequence[NodeChange]) -> tuple[GivenNode, ...]:
    """The Nodes after the changes, as an API server merges them."""
    by_name = {change.node: change for change in changes}

    def merged(node: GivenNode) -> GivenNode:
        change = by_name.get(node.name, NodeChange(node.name, {}, {}))
        both = {**node.labels, **change.labels}, {**node.annotations, **change.annotations}
        labels, annotations = ({key: value for key, value in one.items() if value is not None} for one in both)
        return replace(node, labels=labels, annotations=annotations)

    return tuple(map(merged, nodes))


def file(folder: Path, document: Any) -> Path:
    path = folder / "agents.yaml"
    text = document if isinstance(document, (str, bytes)) else yaml.safe_dump(document)
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_a_file_names_nodes_or_their_labels(tmp_path: Path) -> None:
    path = file(
        tmp_path,
        {
            "agents": [
                {"node": "worker-1", "role": "platform", "agent": "platform"},
                {"selector": {"pool": "robots"}, "role": "vehicle", "agent": "vehicle-00", "capabilities": ["lidar"]},
            ]
        },
    )
    assert mapping.read(path) == AgentsFile((PLATFORM, ROBOTS))


ENTRY = {"node": "worker-1", "role": "vehicle", "agent": "vehicle-00"}


@pytest.mark.parametrize(
    ("document", "problem"),
    [
        ("agents: [", "is not YAML"),
        ({}, "agents: must be a list with at least one entry"),
        ({"agents": []}, "agents: must be a list with at least one entry"),
        ({"agents": ["worker-1"]}, "agents[0]: must be a mapping"),
        ({"agents": [ENTRY | {"agents": []}]}, "agents[0].agents: is unknown; known keys are agent, capabilities,"),
        ({"agents": [ENTRY | {"selector": {"a": "b"}}]}, "agents[0]: must have either node"),
        ({"agents": [{"role": "vehicle", "agent": "a"}]}, "agents[0]: must have either node"),
        ({"agents": [ENTRY | {"node": 7}]}, "agents[0].node: 7 must be the name of a Node"),
        ({"agents": [ENTRY, ENTRY | {"role": "Vehicle"}]}, "agents[1].role: 'Vehicle' must be lower-case"),
        ({"agents": [ENTRY | {"role": "drone"}]}, "'drone' must be one of platform, cloud, edge, roadside, vehicle"),
        ({"agents": [ENTRY | {"agent": "1-car"}]}, "agents[0].agent: '1-car' becomes a namespace and a ROS name"),
        ({"agents": [ENTRY | {"agent": "a" * 23}]}, "must begin with a letter and have at most 22 characters"),
        ("agents: [{node: a, role: vehicle, agent: b}]\nagents: []", "agents stands twice in one mapping; keep one"),
        ("agents: [{node: a, node: b}]", "node stands twice in one mapping"),
        (b"agents: \xff", "is not text in UTF-8"),
        ({"agents": [ENTRY | {"agent": None}]}, "agents[0].agent: None must be lower-case"),
        ({"agents": [ENTRY], "trial": "yes"}, "trial: 'yes' must be true (several agents may share a Node) or false"),
        ({"agents": [ENTRY], "trail": True}, "trail: is unknown; known keys are agents, trial"),
        ({"agents": [ENTRY | {"capabilities": "lidar"}]}, "agents[0].capabilities: must be a list"),
        ({"agents": [ENTRY | {"capabilities": [{"lidar": 2}]}]}, "agents[0].capabilities: {'lidar': 2} must be"),
        ({"agents": [{"selector": {}, "role": "vehicle", "agent": "a"}]}, "agents[0].selector: must be labels"),
        ({"agents": [{"selector": {"robot": 7}, "role": "vehicle", "agent": "a"}]}, 'quotes: "7"'),
    ],
)
def test_a_wrong_file_is_refused_by_key_and_fix(tmp_path: Path, document: Any, problem: str) -> None:
    path = file(tmp_path, document)
    with pytest.raises(InputError) as refused:
        mapping.read(path)
    assert str(refused.value).startswith(f"{path}: ")
    assert problem in str(refused.value)


def test_a_missing_file_shows_how_to_write_one(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot be read .*for example: agents:"):
        mapping.read(tmp_path / "agents.yaml")


def test_nodes_become_agents_and_what_was_added_stands_on_them() -> None:
    changes = adding(NODES, BOTH)
    assert [change.node for change in changes] == ["worker-1", "worker-2"]
    control_plane, worker_1, worker_2 = written(NODES, changes)
    assert control_plane == NODES[0]
    assert worker_1.labels == {"kubernetes.io/hostname": "worker-1", ROLE: "platform", AGENT: "platform"}
    assert worker_2.labels["robotkube.io/capability.lidar"] == "true"
    assert worker_2.added == ROBOTS.labels
    assert "label robotkube.io/agent = vehicle-00" in str(changes[1])


def test_the_same_again_changes_nothing() -> None:
    done = written(NODES, adding(NODES, BOTH))
    assert adding(done, BOTH) == ()
    assert removing(NODES) == ()


def test_another_file_replaces_what_was_added_before() -> None:
    done = written(NODES, adding(NODES, BOTH))
    other = replace(PLATFORM, role="cloud", agent="cloud-0")
    after = written(done, adding(done, AgentsFile((other,))))
    assert after[1].labels[ROLE] == "cloud"
    assert after[2] == NODES[2]
    assert written(after, removing(after)) == NODES


def test_labels_that_were_there_are_neither_recorded_nor_removed() -> None:
    nodes = (replace(NODES[1], labels={ROLE: "platform"}),)
    done = written(nodes, adding(nodes, AgentsFile((PLATFORM,))))
    assert done[0].added == {AGENT: "platform"}
    assert written(done, removing(done)) == nodes


def test_a_label_with_another_value_stands_in_the_way() -> None:
    nodes = (replace(NODES[1], labels={AGENT: "robot-7"}),)
    with pytest.raises(InputError, match=r"Node worker-1: has label robotkube.io/agent=robot-7, which was not added"):
        adding(nodes, AgentsFile((PLATFORM,)))


def test_what_somebody_changed_since_stays_and_that_is_said() -> None:
    [done] = written(NODES[1:2], adding(NODES[1:2], AgentsFile((PLATFORM,))))
    changed = replace(done, labels={**done.labels, ROLE: "cloud"})
    [change] = removing([changed])
    assert "label robotkube.io/role=cloud stays: it was added as platform" in str(change)
    [after] = written([changed], [change])
    assert after == replace(NODES[1], labels={**NODES[1].labels, ROLE: "cloud"})
    assert removing([after]) == ()


def test_an_entry_without_a_node_names_those_that_are_there() -> None:
    with pytest.raises(
        InputError, match=r"worker-9.*there is no such Node; there is: control-plane, worker-1, worker-2"
    ):
        adding(NODES, AgentsFile((replace(PLATFORM, node="worker-9"),)))


def test_a_node_is_one_agents_and_an_agent_has_one_role() -> None:
    with pytest.raises(InputError, match=r"Node worker-2 is asked for by .*: name another Node, or .* trial: true"):
        adding(NODES, AgentsFile((ROBOTS, replace(PLATFORM, node="worker-2"))))
    with pytest.raises(InputError, match=r"has role cloud, another entry vehicle"):
        adding(NODES, AgentsFile((ROBOTS, replace(PLATFORM, role="cloud", agent="vehicle-00"))))


def test_an_annotation_that_nobody_can_read_is_not_guessed() -> None:
    with pytest.raises(InputError, match=r"Node worker-1: annotation .*: 'x' is no object"):
        removing([replace(NODES[1], annotations={ADDED: "x"})])


@pytest.mark.parametrize("seed", range(50))
def test_whatever_was_added_in_turns_goes_exactly(seed: int) -> None:
    choose = random.Random(seed)  # noqa: S311 - a case is named by its number
    keys = (AGENT, ROLE, "robotkube.io/capability.lidar")
    values = {AGENT: "a", ROLE: "vehicle", keys[2]: "true"}
    nodes = tuple(
        GivenNode(f"n{number}", {"pool": "p", **{key: values[key] for key in keys if choose.random() < 0.3}})
        for number in range(3)
    )
    present = nodes
    for _ in range(4):
        chosen = choose.sample([node.name for node in nodes], choose.randint(1, 3))
        capabilities = ("lidar",) if choose.random() < 0.5 else ()
        entries = [AgentEntry(name, (), "vehicle", "a", capabilities) for name in chosen]
        guests = [AgentEntry(chosen[0], (), "vehicle", f"b{number}") for number in range(choose.randint(0, 2))]
        file = AgentsFile((*entries[: 1 if guests else 3], *guests), trial=True)
        present = written(present, adding(present, file))
        assert adding(present, file) == ()
        for node in present:
            assert all(
                entry.node != node.name or entries[0].labels.items() <= node.labels.items() for entry in file.entries
            )
    assert written(present, removing(present)) == nodes


def test_in_trial_mode_a_node_is_several_agents_by_labels_of_each() -> None:
    """The platform's Node has the cloud as its host, on which charts are tried; the first vehicle is the other's."""
    _, worker_1, worker_2 = done = written(NODES, adding(NODES, TRIAL))
    assert {key: value for key, value in worker_1.labels.items() if "robotkube" in key} == {
        **CLOUD.labels,
        "agent.robotkube.io/platform": "1",
        "role.robotkube.io/platform": "platform",
    }
    assert {key: value for key, value in worker_2.labels.items() if "robotkube" in key} == {
        **ROBOTS.labels,
        "agent.robotkube.io/vehicle-01": "1",
        "role.robotkube.io/vehicle-01": "vehicle",
        "lidar.capability.robotkube.io/vehicle-01": "true",
        "recording.capability.robotkube.io/vehicle-01": "true",
    }
    assert [agent.name for agent in node_agents(worker_2.labels)] == ["vehicle-00", "vehicle-01"]
    assert adding(done, TRIAL) == ()
    assert written(done, removing(done)) == NODES


def test_from_trial_mode_to_nodes_of_their_own_and_back() -> None:
    own = AgentsFile((CLOUD, replace(ROBOTS, node="worker-2", selector=())))
    trial = written(NODES, adding(NODES, TRIAL))
    after = written(trial, adding(trial, own))
    assert after == written(NODES, adding(NODES, own))
    assert written(after, adding(after, TRIAL)) == trial


def test_who_shares_a_node_has_that_one_alone() -> None:
    elsewhere = AgentsFile((*TRIAL.entries, replace(SECOND, node="control-plane")), trial=True)
    with pytest.raises(
        InputError, match=r"agent vehicle-01 shares Node worker-2 and stands on worker-2, control-plane"
    ):
        adding(NODES, elsewhere)
    twice = AgentsFile((SECOND, SECOND), trial=True)
    with pytest.raises(
        InputError, match=r"agent vehicle-01 shares Node worker-2 and stands on worker-2, worker-2; who"
    ):
        adding(NODES, twice)


def test_the_platform_is_found_by_the_label_it_has() -> None:
    by_role = {"a": {"robotkube.io/agent": "p", "robotkube.io/role": "platform"}}
    assert sharing.platform_values(by_role) == {}
    shared = wanted_labels(NODES, TRIAL)
    assert sharing.platform_values(shared) == {"platform": {"nodeSelector": {"agent.robotkube.io/platform": "1"}}}
    with pytest.raises(InputError, match=r"Nodes a, worker-1 are of role platform; .* it has one alone"):
        sharing.platform_values({**shared, **by_role})


def test_no_more_share_a_node_than_there_are_ros_domains_for() -> None:
    many = [replace(SECOND, agent=f"vehicle-{number:02}") for number in range(GUESTS_MAX + 2)]
    assert [one.guest for one in sharing.numbered(many[:-1])] == list(range(GUESTS_MAX + 1))
    with pytest.raises(InputError, match=r"82 agents on one Node; 81 can share one"):
        sharing.numbered(many)


def test_a_table_of_nodes_says_that_agents_share_them() -> None:
    items = [
        {"metadata": {"name": node.name, "labels": dict(node.labels)}, "status": {}}
        for node in written(NODES, adding(NODES, TRIAL))
    ]
    states = [state for item in items for state in node_states.node_states(item) if state.agent]
    assert [(state.name, state.agent, state.guest) for state in states] == [
        ("worker-1", "cloud-0", 0),
        ("worker-1", "platform", 1),
        ("worker-2", "vehicle-00", 0),
        ("worker-2", "vehicle-01", 1),
    ]
    said = node_states.nodes_table(states).splitlines()[-1]
    assert said.startswith(
        "trial mode: agents share Nodes (Node worker-1 is cloud-0, platform; Node worker-2 is vehicle-00, vehicle-01)"
    )
    assert "trial mode" not in node_states.nodes_table(states[:1])


def test_the_charts_agents_are_those_of_the_file() -> None:
    recording = replace(PLATFORM, node="worker-3", role="cloud", agent="cloud-0")
    entries = (PLATFORM, ROBOTS, recording, replace(recording, node="worker-4", capabilities=("recording",)))
    assert chart_agents(entries) == [
        {"name": "vehicle-00", "role": "vehicle", "claims": [{"name": "bags", "size": "2Gi"}]},
        {"name": "cloud-0", "role": "cloud", "records": True},
    ]


BUILT = [Image(name, f"forge.example.com:3000/robotkube/{name}@sha256:{'a' * 64}", Path()) for name in ("gitea", "ros")]


class Registry:
    """An OCI registry with one of the two images; it notes whose it is."""

    asked: ClassVar[list[tuple[str, ...]]] = []

    def __init__(self, *access: str, authority: Path | None = None) -> None:
        self.asked.append((*access, str(authority)))

    def __enter__(self) -> Registry:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is open."""

    def manifest_digest(self, repository: str, reference: str) -> str | None:
        return reference if repository == "robots/robotkube/gitea" else None


def test_images_are_looked_for_where_the_chart_pulls_them() -> None:
    assert registry.missing(Registry(), registry.place_of("registry.example.com/robots/robotkube"), BUILT) == ["ros"]
    with pytest.raises(InputError, match=r"REGISTRY Example: write HOST/PATH in lower case"):
        registry.place_of("Example")


def test_what_the_registry_lacks_is_named_with_what_brings_it_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DOCKER_CONFIG", str(tmp_path))
    monkeypatch.setattr(registry, "OciRegistry", Registry)
    place = "registry.example.com/robots/robotkube"
    registry.require(place, BUILT[:1], Path("ca.pem"))
    assert Registry.asked[-1] == ("https://registry.example.com", "", "", "ca.pem")
    with pytest.raises(SetUpError, match=rf"{place}: has not ros; .* robotkube bundle push FILE --to {place}"):
        registry.require(place, BUILT)
    assert Registry.asked[-1] == ("https://registry.example.com", "", "", "None")


def test_a_registry_that_does_not_answer_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DOCKER_CONFIG", str(tmp_path))
    with pytest.raises(SetUpError, match=r"REGISTRY 127.0.0.1:9/robots: "):
        registry.require("127.0.0.1:9/robots", BUILT)
