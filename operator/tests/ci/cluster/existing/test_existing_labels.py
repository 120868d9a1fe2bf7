"""Nodes of a cluster that is there: which become whose, what is added to them, and that exactly this goes again."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import pytest
import yaml

from ci.cluster.existing import mapping, registry
from ci.cluster.existing.labels import ADDED, Change, GivenNode, adding, removing
from ci.cluster.existing.mapping import AgentEntry
from ci.cluster_contract.topology import chart_agents
from ci.errors import InputError, SetUpError
from ci.images.image_lock import Image

AGENT, ROLE = "robotkube.io/agent", "robotkube.io/role"
PLATFORM = AgentEntry("worker-1", (), "platform", "platform")
ROBOTS = AgentEntry("", (("pool", "robots"),), "vehicle", "vehicle-00", ("lidar",))
NODES = (
    GivenNode("control-plane", {"kubernetes.io/hostname": "control-plane"}),
    GivenNode("worker-1", {"kubernetes.io/hostname": "worker-1"}, {"theirs": "x"}),
    GivenNode("worker-2", {"pool": "robots"}),
)


def written(nodes: Sequence[GivenNode], changes: Sequence[Change]) -> tuple[GivenNode, ...]:
    """The Nodes after the changes, as an API server merges them."""
    by_name = {change.node: change for change in changes}

    def merged(node: GivenNode) -> GivenNode:
        change = by_name.get(node.name, Change(node.name, {}, {}))
        both = {**node.labels, **change.labels}, {**node.annotations, **change.annotations}
        labels, annotations = ({key: value for key, value in one.items() if value is not None} for one in both)
        return replace(node, labels=labels, annotations=annotations)

    return tuple(map(merged, nodes))


def file(folder: Path, document: Any) -> Path:
    path = folder / "agents.yaml"
    path.write_text(document if isinstance(document, str) else yaml.safe_dump(document), encoding="utf-8")
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
    assert mapping.read(path) == (PLATFORM, ROBOTS)


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
        ({"agents": [ENTRY | {"agent": None}]}, "agents[0].agent: None must be lower-case"),
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
    changes = adding(NODES, (PLATFORM, ROBOTS))
    assert [change.node for change in changes] == ["worker-1", "worker-2"]
    control_plane, worker_1, worker_2 = written(NODES, changes)
    assert control_plane == NODES[0]
    assert worker_1.labels == {"kubernetes.io/hostname": "worker-1", ROLE: "platform", AGENT: "platform"}
    assert worker_2.labels["robotkube.io/capability.lidar"] == "true"
    assert worker_2.added == ROBOTS.labels
    assert "label robotkube.io/agent = vehicle-00" in str(changes[1])


def test_the_same_again_changes_nothing() -> None:
    done = written(NODES, adding(NODES, (PLATFORM, ROBOTS)))
    assert adding(done, (PLATFORM, ROBOTS)) == ()
    assert removing(NODES) == ()


def test_another_file_replaces_what_was_added_before() -> None:
    done = written(NODES, adding(NODES, (PLATFORM, ROBOTS)))
    other = replace(PLATFORM, role="cloud", agent="cloud-0")
    after = written(done, adding(done, (other,)))
    assert after[1].labels[ROLE] == "cloud"
    assert after[2] == NODES[2]
    assert written(after, removing(after)) == NODES


def test_labels_that_were_there_are_neither_recorded_nor_removed() -> None:
    nodes = (replace(NODES[1], labels={ROLE: "platform"}),)
    done = written(nodes, adding(nodes, (PLATFORM,)))
    assert done[0].added == {AGENT: "platform"}
    assert written(done, removing(done)) == nodes


def test_a_label_with_another_value_stands_in_the_way() -> None:
    nodes = (replace(NODES[1], labels={AGENT: "robot-7"}),)
    with pytest.raises(InputError, match=r"Node worker-1: has label robotkube.io/agent=robot-7, which was not added"):
        adding(nodes, (PLATFORM,))


def test_what_somebody_changed_since_stays_and_that_is_said() -> None:
    [done] = written(NODES[1:2], adding(NODES[1:2], (PLATFORM,)))
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
        adding(NODES, (replace(PLATFORM, node="worker-9"),))


def test_a_node_is_one_agents_and_an_agent_has_one_role() -> None:
    with pytest.raises(InputError, match=r"Node worker-2 is asked for by .* and by .*; a Node is one agent's"):
        adding(NODES, (ROBOTS, replace(PLATFORM, node="worker-2")))
    with pytest.raises(InputError, match=r"has role cloud, another entry vehicle"):
        adding(NODES, (ROBOTS, replace(PLATFORM, role="cloud", agent="vehicle-00")))


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
        present = written(present, adding(present, entries))
        assert adding(present, entries) == ()
        for node in present:
            assert node.name not in chosen or entries[0].labels.items() <= node.labels.items()
    assert written(present, removing(present)) == nodes


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
