"""`existing` on a real API server: Nodes become agents', nobody is overrun, and then every object is as before."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from ci.cluster import __main__ as commands
from ci.cluster.existing import nodes as existing
from ci.cluster.existing.labels import ADDED
from ci.cluster.existing.nodes import GivenCluster, GivenNodes
from ci.cluster.existing.provider import Existing
from ci.errors import InputError, SetUpError
from tests.stages.kubernetes.api_calls import Api
from tests.stages.kubernetes.api_server import ApiServerProcess

pytestmark = pytest.mark.toolchain

NODES = ("given-1", "given-2", "given-3")
BEFORE = {"pool": "robots"}
AGENTS = {
    "agents": [
        {"node": "given-1", "role": "platform", "agent": "platform"},
        {"selector": BEFORE, "role": "vehicle", "agent": "vehicle-00", "capabilities": ["lidar"]},
    ]
}
OWN_OF_THE_SERVER = {"leases", "events", "tokenreviews"}


@pytest.fixture
def api(api_server: ApiServerProcess, api: Api) -> Iterator[Api]:
    """Three Nodes that nobody of ours made."""
    for name in NODES:
        labels = BEFORE if name == "given-2" else {}
        api.post("/api/v1/nodes", {"apiVersion": "v1", "kind": "Node", "metadata": {"name": name, "labels": labels}})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield api
    for name in NODES:
        api.delete(f"/api/v1/nodes/{name}")


@pytest.fixture
def given(api_server: ApiServerProcess, api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> GivenCluster:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    agents = tmp_path / "agents.yaml"
    agents.write_text(yaml.safe_dump(AGENTS))
    return GivenCluster(str(api_server.kubeconfig), agents=agents, agreed=True)


def everything(api: Api) -> Mapping[str, Any]:
    """Every object of the API server by its path and name, without what counts its versions."""
    groups = [version["groupVersion"] for group in api.get("/apis")["groups"] for version in group["versions"]]
    objects = {}
    for path in ("/api/v1", *(f"/apis/{group}" for group in groups)):
        kinds = [one["name"] for one in api.get(path)["resources"] if "list" in one["verbs"]]
        for kind in set(kinds) - OWN_OF_THE_SERVER:
            for item in api.get(f"{path}/{kind}").get("items", []):
                metadata = item.get("metadata", {})
                for key in ("resourceVersion", "managedFields"):
                    metadata.pop(key, None)
                objects[f"{path}/{kind}/{metadata.get('namespace', '')}/{metadata.get('name')}"] = item
    return objects


def labels(api: Api, name: str) -> Mapping[str, str]:
    of_node: Mapping[str, str] = api.get(f"/api/v1/nodes/{name}")["metadata"].get("labels", {})
    return of_node


def test_what_was_added_goes_and_every_object_is_as_before(api: Api, given: GivenCluster, tmp_path: Path) -> None:
    before = everything(api)
    assert "/api/v1/nodes//given-1" in before
    cluster = Existing(given)
    assert len(cluster.take()) == 2
    assert labels(api, "given-1")["robotkube.io/role"] == "platform"
    assert labels(api, "given-2")["robotkube.io/agent"] == "vehicle-00"
    assert "robotkube.io/agent" not in labels(api, "given-3")
    assert [(node.name, node.role, node.agent) for node in cluster.nodes()] == [
        ("given-1", "platform", "platform"),
        ("given-2", "vehicle", "vehicle-00"),
    ]
    assert "given-2" in cluster.status()
    changed = {name for name, item in everything(api).items() if before.get(name) != item}
    assert changed == {"/api/v1/nodes//given-1", "/api/v1/nodes//given-2"}
    assert yaml.safe_load(cluster.values_file.read_text()) == {
        "agents": [{"name": "vehicle-00", "role": "vehicle", "claims": [{"name": "bags", "size": "2Gi"}]}]
    }
    further = tmp_path / "further.yaml"
    further.write_text("storage: {className: fast}\n")
    assert Existing(replace(given, values=further)).take() == ()
    assert yaml.safe_load(cluster.values_file.read_text())["storage"] == {"className": "fast"}
    assert cluster.take() == ()
    assert len(cluster.down()) == 2
    assert everything(api) == before
    assert not cluster.values_file.exists()
    assert cluster.down() == ()


def test_agents_that_share_nodes_leave_nothing_either(api: Api, given: GivenCluster) -> None:
    guest = {"node": "given-2", "role": "vehicle", "agent": "vehicle-01", "capabilities": ["lidar"]}
    given.agents.write_text(yaml.safe_dump({"trial": True, "agents": [*AGENTS["agents"], guest]}))
    before = everything(api)
    asked: list[str] = []
    cluster = Existing(replace(given, agreed=False), lambda text: asked.append(text) or True)
    said = "trial mode: agents share Nodes (Node given-2 is vehicle-00, vehicle-01)"
    assert said in cluster.planned()[-1]
    assert len(cluster.take()) == 2
    assert said in asked[0]
    assert labels(api, "given-2")["agent.robotkube.io/vehicle-01"] == "1"
    assert [(node.name, node.agent, node.guest) for node in cluster.nodes()] == [
        ("given-1", "platform", 0),
        ("given-2", "vehicle-00", 0),
        ("given-2", "vehicle-01", 1),
    ]
    assert said in cluster.status()
    assert said in cluster.lacks[-1]
    assert cluster.take() == ()
    cluster.down()
    assert everything(api) == before


def test_nothing_is_written_until_somebody_agrees(api: Api, given: GivenCluster) -> None:
    before = everything(api)
    asked = []

    def refuse(text: str) -> bool:
        asked.append(text)
        return False

    with pytest.raises(InputError, match=r"nothing was written, since nobody agreed; YES=1"):
        Existing(GivenCluster(given.kubeconfig, agents=given.agents), refuse).take()
    [text] = asked
    assert "was not made here" in text
    assert "Node given-2: label robotkube.io/role = vehicle" in text
    assert everything(api) == before


def test_who_has_no_terminal_has_not_agreed(capsys: pytest.CaptureFixture[str]) -> None:
    assert not existing.ask_on_terminal("would be written")
    assert "would be written" in capsys.readouterr().err


def test_who_writes_to_a_node_meanwhile_is_not_overrun(
    api: Api, given: GivenCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A Node changes between reading and writing: it is read again, and what the other one wrote stays."""
    listed = GivenNodes.objects
    turns = []

    def meanwhile(self: GivenNodes) -> list[Mapping[str, Any]]:
        nodes = listed(self)
        if not turns:
            turns.append(1)
            api.merge("/api/v1/nodes/given-1", {"metadata": {"labels": {"theirs": "new"}}})
        return nodes

    monkeypatch.setattr(GivenNodes, "objects", meanwhile)
    cluster = Existing(given)
    cluster.take()
    assert labels(api, "given-1")["theirs"] == "new"
    assert labels(api, "given-1")["robotkube.io/agent"] == "platform"
    cluster.down()
    assert labels(api, "given-1") == {"theirs": "new"}


def test_what_is_refused_has_changed_no_node(api: Api, given: GivenCluster) -> None:
    api.merge("/api/v1/nodes/given-2", {"metadata": {"labels": {"robotkube.io/agent": "robot-7"}}})
    before = everything(api)
    with pytest.raises(InputError, match=r"Node given-2: has label robotkube.io/agent=robot-7"):
        Existing(given).take()
    assert everything(api) == before


def test_the_command_takes_nodes_and_gives_them_back(
    api: Api, given: GivenCluster, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--cluster", "existing", "--kubeconfig", given.kubeconfig, "--agents", str(given.agents), "--yes"]
    commands.run(commands.arguments().parse_args(["up", "--dry-run", *words]))
    assert "Node given-1: label robotkube.io/role = platform" in capsys.readouterr().out
    assert "robotkube.io/role" not in labels(api, "given-1")
    commands.run(commands.arguments().parse_args(["up", *words]))
    said = capsys.readouterr().out
    assert "2 Nodes changed" in said
    assert "not given: application charts name images" in said
    assert ADDED in api.get("/api/v1/nodes/given-1")["metadata"]["annotations"]
    commands.run(commands.arguments().parse_args(["down", *words]))
    assert "kept: the cluster itself" in capsys.readouterr().out
    commands.run(commands.arguments().parse_args(["down", *words]))
    assert "nothing to remove" in capsys.readouterr().out


def test_a_context_that_is_not_there_and_one_that_does_not_answer(given: GivenCluster, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"give KUBECONFIG and CONTEXT"):
        Existing(GivenCluster(given.kubeconfig, "other"))
    document = yaml.safe_load(Path(given.kubeconfig).read_text())
    document["clusters"][0]["cluster"]["server"] = "https://127.0.0.1:9"
    away = tmp_path / "away"
    away.write_text(yaml.safe_dump(document))
    with pytest.raises(SetUpError, match=r"https://127.0.0.1:9 does not answer"):
        Existing(GivenCluster(str(away), agents=given.agents)).take()
