"""The topology section: what it becomes, and that every refusal names file, key and fix."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from ci.cluster_contract import topology
from ci.errors import InputError

CAPACITY = {"cpu": "1", "memory": "2Gi"}
PLATFORM = {"name": "platform-0", "role": "platform", "agent": "platform-0", "capacity": CAPACITY}
VEHICLES = {
    "name": "vehicle-{index:02}",
    "count": 15,
    "role": "vehicle",
    "agent": "vehicle-{index:02}",
    "capacity": {"cpu": "500m", "memory": "512Mi"},
    "capabilities": ["lidar"],
}


def written(folder: Path, *nodes: object) -> Path:
    path = folder / "scenario.yaml"
    path.write_text(yaml.safe_dump({"topology": {"nodes": list(nodes)}}), encoding="utf-8")
    return path


def test_counts_become_numbered_nodes(tmp_path: Path) -> None:
    nodes = topology.read(written(tmp_path, PLATFORM, VEHICLES)).nodes
    assert [node.name for node in nodes][:3] == ["platform-0", "vehicle-00", "vehicle-01"]
    assert len(nodes) == 16
    assert nodes[15].agent == "vehicle-14"
    assert (nodes[1].cpu_millicores, nodes[1].memory_bytes) == (500, 512 * 2**20)


def test_labels_and_taints_follow_role_agent_and_capabilities(tmp_path: Path) -> None:
    platform, vehicle = topology.read(written(tmp_path, PLATFORM, VEHICLES), {"vehicles": "1"}).nodes
    assert platform.taints == ({"key": "robotkube.io/role", "value": "platform", "effect": "NoSchedule"},)
    assert vehicle.taints == ()
    assert vehicle.labels == {
        "robotkube.io/role": "vehicle",
        "robotkube.io/agent": "vehicle-00",
        "robotkube.io/capability.lidar": "true",
    }


def test_a_capability_may_be_that_of_the_first_nodes_only(tmp_path: Path) -> None:
    entry = {**VEHICLES, "capabilities": ["radar", {"lidar": 2}]}
    nodes = topology.read(written(tmp_path, entry), {"vehicles": "3"}).nodes
    assert [node.capabilities for node in nodes] == [("radar", "lidar"), ("radar", "lidar"), ("radar",)]


def test_a_parameter_overrides_the_count(tmp_path: Path) -> None:
    assert len(topology.read(written(tmp_path, PLATFORM, VEHICLES), {"vehicles": "3"}).nodes) == 4


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({**PLATFORM, "colour": "red"}, "topology.nodes[0].colour: is unknown; known keys are"),
        ({**PLATFORM, "name": "Platform"}, "topology.nodes[0].name: 'Platform' must be lower-case"),
        ({**PLATFORM, "name": "p-{number}"}, "topology.nodes[0].name: 'p-{number}' may contain only {index}"),
        ({**PLATFORM, "count": 2}, "topology.nodes[0].name: must contain {index:02}"),
        ({**VEHICLES, "count": -1}, "topology.nodes[0].count: -1 must be a whole number"),
        ({**PLATFORM, "capacity": {"cpu": "much", "memory": "2Gi"}}, "topology.nodes[0].capacity.cpu: 'much' must be"),
        ({**PLATFORM, "capacity": {"cpu": "1", "memory": "2G"}}, "topology.nodes[0].capacity.memory: '2G' must be"),
        ({**PLATFORM, "capacity": None}, "topology.nodes[0].capacity: is missing; add"),
        ({**PLATFORM, "capabilities": "recording"}, "topology.nodes[0].capabilities: must be a list"),
        ({**PLATFORM, "capabilities": [{"lidar": "two"}]}, "topology.nodes[0].capabilities.lidar: 'two' must be how"),
        ("platform-0", "topology.nodes[0]: must be a mapping"),
    ],
)
def test_a_wrong_entry_is_refused_with_file_and_key(tmp_path: Path, entry: object, message: str) -> None:
    path = written(tmp_path, entry)
    with pytest.raises(InputError) as refused:
        topology.read(path)
    assert str(refused.value).startswith(f"{path}: {message}")


def test_names_must_differ(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'platform-0' occurs twice"):
        topology.read(written(tmp_path, PLATFORM, PLATFORM))


@pytest.mark.parametrize(("name", "value"), [("robots", "3"), ("vehicles", "three")])
def test_a_wrong_parameter_is_refused(tmp_path: Path, name: str, value: str) -> None:
    with pytest.raises(InputError, match=f"--set {name}"):
        topology.read(written(tmp_path, VEHICLES), {name: value})


@pytest.mark.parametrize("text", ["topology: [", "parameters: {}", "[]"])
def test_a_file_without_topology_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "scenario.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        topology.read(path)
    assert str(refused.value).startswith(f"{path}: ")


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        topology.read(tmp_path / "none.yaml")
