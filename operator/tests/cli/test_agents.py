"""The commands `robotkube agent list` and `agent rights`: who is revoked, and each right with the release and the
commit that gave it."""

from __future__ import annotations

import json
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pygit2
import pytest
import yaml

from robotkube.cli.agents import rights
from robotkube.cli.agents.accounts import Ends, OfMain, rows, shared_rows
from robotkube.cli.main import main
from robotkube.cli.platform import AGENT_LABEL
from robotkube.delivery.deployment.core.policies.agents import PATH as AGENTS_PATH
from robotkube.delivery.deployment.core.policies.agents import write_enrolled
from robotkube.delivery.deployment.core.policies.links import path_of
from robotkube.delivery.deployment.core.policies.revoked import PATH as REVOKED_PATH
from robotkube.delivery.deployment.core.policies.revoked import write_revoked
from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.rights.core.accounts import AgentAccount, ManagerAccount
from robotkube.delivery.rights.core.origins import enrollments, revocations
from robotkube.foundation.forge.adapters.git import GitHistory
from tests.stages.delivery.rights.main_of_links import POSE_00, POSE_01, bridge, texts
from tests.stages.delivery.rights.rights_broker import ACCOUNTS
from tests.stages.kubernetes.api_calls import Api

SIGNATURE = pygit2.Signature("manager", "manager@forge.invalid", 1_795_000_000, 0)


class Repository:
    """A clone of a deployment repository; `merge` makes a commit with these releases and no others."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._repository = pygit2.init_repository(str(folder), bare=True, initial_head="main")
        self._parents: list[pygit2.Oid] = []

    def merge(self, subject: str, *releases: Release, **files: str) -> str:
        index = pygit2.Index()
        for path, text in {**texts(*releases), **files}.items():
            blob = self._repository.create_blob(text.encode())
            index.add(pygit2.IndexEntry(path, blob, pygit2.enums.FileMode.BLOB))
        tree = index.write_tree(self._repository)
        commit = self._repository.create_commit("refs/heads/main", SIGNATURE, SIGNATURE, subject, tree, self._parents)
        self._parents = [commit]
        return str(commit)[:12]


@pytest.fixture
def repository(tmp_path: Path) -> Repository:
    return Repository(tmp_path / "deployment.git")


def shown(repository: Repository, capsys: pytest.CaptureFixture[str], agent: str, role: str) -> list[dict[str, Any]]:
    words = ["agent", "rights", agent, "--role", role, "--clone", str(repository.folder), "-o", "json"]
    assert main(words) == 0
    return list(json.loads(capsys.readouterr().out)["rights"])


def test_each_right_names_the_commit_that_gave_it(repository: Repository, capsys: pytest.CaptureFixture[str]) -> None:
    repository.merge("begin", bridge("vehicle-01", POSE_00))
    repository.merge("pose, for the first time", bridge("vehicle-00", POSE_01))
    repository.merge("withdrawn", bridge("vehicle-01", POSE_00))
    again = repository.merge("pose again", bridge("vehicle-00", POSE_01))
    plan = repository.merge("and a plan", bridge("vehicle-00", POSE_01, "/agents/cloud_0/plan"))
    rows = shown(repository, capsys, "vehicle-00", "vehicle")
    given = {row["topic"]: (row["given_by"], row["commit"], row["subject"]) for row in rows if row["commit"]}
    assert given == {
        "mqtt/vehicles/vehicle_01/pose": ("vehicle-00/mqtt-bridge", again, "pose again"),
        "mqtt/agents/cloud_0/plan": ("vehicle-00/mqtt-bridge", plan, "and a plan"),
    }
    always = {(row["may"], row["topic"]) for row in rows if row["given_by"] == "always"}
    assert {("write", "mqtt/vehicles/vehicle_00/#"), ("write", "robotkube/tasks/vehicle-00")} <= always
    assert rows[0]["may"] == "write"


def test_a_file_that_cannot_be_read_takes_nothing_away(
    repository: Repository, capsys: pytest.CaptureFixture[str]
) -> None:
    first = repository.merge("begin", bridge("cloud-0", "/vehicles/{agent}/pose"))
    repository.merge("broken", **{"releases/cloud-0/mqtt-bridge.yaml": "no release"})
    [row] = [row for row in shown(repository, capsys, "cloud-0", "cloud") if row["commit"]]
    assert (row["topic"], row["commit"]) == ("mqtt/vehicles/+/pose", first)


def test_without_a_cluster_the_role_is_needed(repository: Repository, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["agent", "rights", "vehicle-00", "--clone", str(repository.folder)]) == 2
    assert "give the agent's --role" in capsys.readouterr().err


# -- agents and their accounts -----------------------------------------------------------------------------------------

STOLEN = {"vehicle-00": "its computer was stolen"}


def node(name: str, agent: str, ready: str) -> dict[str, Any]:
    conditions = [{"type": "MemoryPressure", "status": "True"}, {"type": "Ready", "status": ready}]
    status = {"conditions": conditions, "nodeInfo": {"kubeletVersion": "v1.36.0"}}
    return {"metadata": {"name": name, "labels": {AGENT_LABEL: agent}}, "status": status}


def lease(name: str, time: str) -> dict[str, Any]:
    return {"metadata": {"name": name}, "spec": {"renewTime": time}}


def test_an_agent_has_an_account_and_what_its_nodes_say(repository: Repository) -> None:
    repository.merge("begin")
    commit = repository.merge("shut it", **{REVOKED_PATH: write_revoked(STOLEN)})
    repository.merge("and another", **{REVOKED_PATH: write_revoked({**STOLEN, "cloud-0": "odd"})})
    nodes = [
        node("vehicle-00-a", "vehicle-00", "True"),
        node("vehicle-00-b", "vehicle-00", "Unknown"),
        node("v1", "vehicle-01", "False"),
    ]
    leases = [
        lease("vehicle-00-b", "2026-11-26T10:00:09.000000Z"),
        lease("vehicle-00-a", "2026-11-26T10:00:01.500000Z"),
        lease("other", "2027-01-01T00:00:00.000000Z"),
    ]
    said = OfMain(revocations(GitHistory(repository.folder).commits({})), {})
    ends = Ends(certificates={"vehicle-01": 1_795_651_200.0})
    agents = rows(ACCOUNTS.agents, said, nodes, leases, ends)
    assert [row["agent"] for row in agents] == ["cloud-0", "roadside-0", "vehicle-00", "vehicle-01"]
    vehicle, other = agents[2], agents[3]
    assert vehicle == {
        **{"agent": "vehicle-00", "role": "vehicle", "namespace": "vehicle-00", "account": "revoked"},
        **{"declared": "values", "reason": "its computer was stolen", "by": "manager", "commit": commit},
        **{"nodes": 2, "ready": 1, "seen": "2026-11-26T10:00:09Z"},
        **{"kubelet": ["v1.36.0"], "releases": [], "certificate_until": "", "join_until": ""},
    }
    assert other["certificate_until"] == "2026-11-26T00:00:00Z"
    assert (other["account"], other["nodes"], other["ready"], other["seen"]) == ("open", 1, 0, "")


def test_agents_that_share_a_node_count_it_each_and_that_is_said() -> None:
    shared = node("worker", "vehicle-00", "True")
    shared["metadata"]["labels"]["agent.robotkube.io/vehicle-01"] = "1"
    nodes = [shared, node("cloud-0", "cloud-0", "True")]
    agents = rows(ACCOUNTS.agents, OfMain({}, {}), nodes, [lease("worker", "2026-11-26T10:00:09.000000Z")], Ends())
    counted = {row["agent"]: (row["nodes"], row["ready"], row["seen"]) for row in agents}
    assert counted["vehicle-00"] == counted["vehicle-01"] == (1, 1, "2026-11-26T10:00:09Z")
    trial = "no machine keeps them apart, and no figure compares machines"
    assert shared_rows(nodes) == [{"node": "worker", "agents": ["vehicle-00", "vehicle-01"], "trial": trial}]
    assert shared_rows(nodes[1:]) == []


RESERVED = (*ACCOUNTS.agents, AgentAccount("vehicle-16", "", "vehicle-16"), AgentAccount("edge-9", "", "edge-9"))


def test_an_enrolled_agent_has_the_role_and_the_commit_of_main(repository: Repository) -> None:
    repository.merge("begin")
    enrolled = {AGENTS_PATH: write_enrolled({"vehicle-16": "vehicle"})}
    commit = repository.merge("enroll", **enrolled)
    repository.merge("later", bridge("vehicle-16", POSE_01), **enrolled)
    commits = GitHistory(repository.folder).commits({})
    said = OfMain({}, enrollments(commits), {"vehicle-16": ["mqtt-bridge 0.2.0"]})
    by_agent = {row["agent"]: row for row in rows(RESERVED, said, [], [], Ends({"edge-9": "2026-11-27T01:00:00Z"}))}
    assert by_agent["vehicle-16"] == {
        **{"agent": "vehicle-16", "role": "vehicle", "namespace": "vehicle-16", "declared": "main"},
        **{"account": "open", "reason": "", "by": "manager", "commit": commit, "nodes": 0, "ready": 0, "seen": ""},
        **{"kubelet": [], "releases": ["mqtt-bridge 0.2.0"], "certificate_until": "", "join_until": ""},
    }
    reserved = by_agent["edge-9"]
    assert (reserved["role"], reserved["declared"], reserved["account"]) == ("", "values", "reserved")
    assert reserved["join_until"] == "2026-11-27T01:00:00Z"
    repository.merge("broken", **{AGENTS_PATH: "agents: none"})
    assert set(enrollments(GitHistory(repository.folder).commits({}))) == {"vehicle-16"}
    repository.merge("gone")
    assert enrollments(GitHistory(repository.folder).commits({})) == {}


def test_rights_of_a_reserved_agent(
    repository: Repository, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(rights, "Platform", lambda _: None)
    monkeypatch.setattr(rights, "declared", lambda _: replace(ACCOUNTS, agents=RESERVED))
    monkeypatch.setattr(rights, "history", lambda _: nullcontext(GitHistory(repository.folder)))
    repository.merge("begin", bridge("vehicle-16", POSE_01))
    assert main(["agent", "rights", "vehicle-16"]) == 0
    assert capsys.readouterr().out == (
        "vehicle-16 is reserved, and has no rights until policies/agents.yaml on main enrolls it\n"
    )
    repository.merge(
        "enroll", bridge("vehicle-16", POSE_01), **{AGENTS_PATH: write_enrolled({"vehicle-16": "vehicle"})}
    )
    assert main(["agent", "rights", "vehicle-16", "-o", "json"]) == 0
    topics = {row["topic"] for row in json.loads(capsys.readouterr().out)["rights"]}
    assert {"mqtt/vehicles/vehicle_16/#", "mqtt/vehicles/vehicle_01/pose"} <= topics


def test_who_is_restored_or_whose_file_is_broken(repository: Repository) -> None:
    repository.merge("begin", **{REVOKED_PATH: write_revoked(STOLEN)})
    repository.merge("broken", **{REVOKED_PATH: "revoked: stolen"})
    assert set(revocations(GitHistory(repository.folder).commits({}))) == {"vehicle-00"}
    repository.merge("gone")
    assert revocations(GitHistory(repository.folder).commits({})) == {}
    again = repository.merge("again", **{REVOKED_PATH: write_revoked(STOLEN)})
    [one] = revocations(GitHistory(repository.folder).commits({})).values()
    assert one.commit.id[:12] == again


def test_a_revoked_agent_has_no_rights(repository: Repository, capsys: pytest.CaptureFixture[str]) -> None:
    repository.merge("begin", bridge("vehicle-00", POSE_01), **{REVOKED_PATH: write_revoked(STOLEN)})
    assert shown(repository, capsys, "vehicle-00", "vehicle") == []
    assert main(["agent", "rights", "vehicle-00", "--role", "vehicle", "--clone", str(repository.folder)]) == 0
    assert capsys.readouterr().out.startswith("vehicle-00 is revoked by commit ")


def test_what_is_heard_of_another_scope_is_by_consent_of_both(
    repository: Repository, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The platform's settings say whose the agents are; here without a cluster."""
    scopes = (ManagerAccount("south", ("vehicle-00", "roadside-0")), ManagerAccount("north", ("vehicle-01", "cloud-0")))
    monkeypatch.setattr(rights, "Platform", lambda _: None)
    monkeypatch.setattr(rights, "declared", lambda _: replace(ACCOUNTS, managers=scopes))
    monkeypatch.setattr(rights, "history", lambda _: nullcontext(GitHistory(repository.folder)))

    def heard() -> set[str]:
        assert main(["agent", "rights", "cloud-0", "-o", "json"]) == 0
        return {row["topic"] for row in json.loads(capsys.readouterr().out)["rights"] if row["commit"]}

    poses = bridge("cloud-0", "/vehicles/{agent}/pose", POSE_00)
    own = {"mqtt/vehicles/vehicle_01/pose", "mqtt/vehicles/cloud_0/pose"}
    repository.merge("begin", poses)
    assert heard() == own
    consents = {
        path_of("south"): f"sends: [{{to: north, topics: [{POSE_00}]}}]\n",
        path_of("north"): f"receives: [{{from: south, topics: [{POSE_00}]}}]\n",
    }
    repository.merge("agreed", poses, **consents)
    assert heard() == {*own, f"mqtt{POSE_00}"}


@pytest.mark.toolchain
def test_agents_of_a_cluster(manager_api: Api, repository: Repository, capsys: pytest.CaptureFixture[str]) -> None:
    """Settings, Nodes and leases as a real API server has them."""
    where = "/api/v1/namespaces/robotkube/configmaps"
    agents = [{"name": agent.name, "role": agent.role, "namespace": agent.namespace} for agent in ACCOUNTS.agents]
    settings = {"config.yaml": yaml.safe_dump({"agents": agents, "managers": []})}
    manager_api.post(where, {"metadata": {"name": "rights"}, "data": settings})
    repository.merge("begin", **{REVOKED_PATH: write_revoked(STOLEN)})
    cluster = ["--kubeconfig", str(manager_api.kubeconfig)]
    try:
        assert main(["agent", "list", "--clone", str(repository.folder), *cluster, "-o", "json"]) == 0
        out = capsys.readouterr().out
        assert main(["agent", "revoke", "vehicle-99", "--reason", "mistyped", *cluster]) == 2
        assert (
            "no agent vehicle-99 is declared; did you mean vehicle-00 or vehicle-01? there are: "
            in capsys.readouterr().err
        )
    finally:
        manager_api.delete(f"{where}/rights")
    by_agent = {row["agent"]: row for row in json.loads(out)["agents"]}
    assert (by_agent["vehicle-00"]["account"], by_agent["vehicle-01"]["account"]) == ("revoked", "open")
    assert (by_agent["cloud-0"]["nodes"], by_agent["cloud-0"]["ready"], by_agent["roadside-0"]["nodes"]) == (1, 1, 0)
