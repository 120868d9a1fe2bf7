"""The manager's eyes on a real API server: what it sees, what wakes it, and what happens when the server goes away."""

import json
import time
from collections.abc import Iterator
from typing import Any

import pytest

from robotkube.delivery.manager.adapters import kubernetes_cluster
from robotkube.delivery.manager.adapters.kubernetes_cluster import KubernetesCluster
from robotkube.delivery.manager.core.observation import judge_present
from robotkube.delivery.manager.core.updates.rule_events import RuleEvent
from robotkube.delivery.tasks.core.task_description import read_task
from robotkube.errors import DocumentError, InputError, UnavailableError
from robotkube.foundation.documents.core.times import time_ns
from robotkube.foundation.kubernetes.adapters import client as kubernetes_client
from robotkube.foundation.kubernetes.adapters.client import ResourceWatch, api_client, call
from tests.stages.kubernetes.api_calls import ARGOCD, TASKS, Api
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

SOURCE = {"repoURL": "oci://forge/verified/mqtt-bridge", "targetRevision": "sha256:0"}


class Seen:
    """A cluster under watch, and what woke the manager."""

    def __init__(self, api_server: ApiServerProcess) -> None:
        self.woken: list[str] = []
        self.client = api_client(str(api_server.kubeconfig))
        self.cluster = KubernetesCluster(self.client, "argocd", self.woken.append, time.time)
        self.cluster.start()
        assert self.cluster.wait_until_synced(20)

    def task_names(self) -> list[str]:
        return [task["metadata"]["name"] for task in self.cluster.tasks()]


@pytest.fixture
def seen(api_server: ApiServerProcess) -> Iterator[Seen]:
    watched = Seen(api_server)
    yield watched
    watched.cluster.stop()


def application(**status: Any) -> dict[str, Any]:
    return {
        "apiVersion": "argoproj.io/v1alpha1",
        "kind": "Application",
        "metadata": {
            "name": "cloud-0-mqtt-bridge",
            "namespace": "argocd",
            "annotations": {"robotkube.io/plan": "p1"},
        },
        "spec": {"source": SOURCE},
        "status": status,
    }


def test_tasks_are_seen_and_their_statuses_written_without_waking_again(api: Api, seen: Seen) -> None:
    api.task("one")
    until(lambda: seen.task_names() == ["one"], "task seen")
    assert read_task(seen.cluster.tasks()[0]).parameters == {"deep": {"x": 1}}
    until(lambda: "tasks" in seen.woken, "the task told")
    condition = {"type": "Accepted", "status": "True", "reason": "Accepted", "message": "m"}
    condition["lastTransitionTime"] = "2026-11-21T10:00:00Z"
    status = {"conditions": [condition], "plan": "p1", "releases": ["cloud-0/a"]}
    seen.woken.clear()
    assert seen.cluster.patch_status("cloud-0", "one", status)
    until(lambda: seen.cluster.tasks()[0].get("status") == status, "status seen")
    assert seen.cluster.patch_status("cloud-0", "one", {"plan": None, "releases": None})
    until(lambda: seen.cluster.tasks()[0]["status"] == {"conditions": [condition]}, "fields removed")
    assert seen.woken == []
    api.delete(f"{TASKS}/one")
    until(lambda: seen.task_names() == [], "deletion seen")
    until(lambda: seen.woken, "the deletion told")
    assert seen.woken == ["tasks"]
    assert not seen.cluster.patch_status("cloud-0", "one", status)
    assert RuleEvent("near", time_ns("2026-11-21T10:00:00Z"), "cloud-0") in seen.cluster.rule_events()


def test_a_status_that_the_definition_refuses_is_an_error_with_the_servers_words(api: Api, seen: Seen) -> None:
    api.task("strict")
    with pytest.raises(InputError, match=r"status\.commit"):
        seen.cluster.patch_status("cloud-0", "strict", {"commit": "short"})
    api.delete(f"{TASKS}/strict")


def test_a_task_nested_too_deeply_blinds_nobody(api: Api, seen: Seen) -> None:
    text = "[" * 5000 + "]" * 5000
    task = {"name": "deep", "namespace": "cloud-0"}
    event = {"rule": "near", "id": "e1", "time": "2026-11-21T10:00:00Z", "trace": "0" * 32}
    spec = {"requester": "somebody", "event": event, "application": "recording", "parameters": {"x": "DEEP"}}
    document = {"apiVersion": "robotkube.io/v1alpha1", "kind": "TaskDescription", "metadata": task, "spec": spec}
    api.post_text(TASKS, json.dumps(document).replace('"DEEP"', text))
    api.task("beside")
    until(lambda: seen.task_names() == ["beside", "deep"], "both seen")
    with pytest.raises(DocumentError, match="nested deeper than 32"):
        read_task(next(task for task in seen.cluster.tasks() if task["metadata"]["name"] == "deep"))
    for name in ("deep", "beside"):
        api.delete(f"{TASKS}/{name}")
    until(lambda: seen.task_names() == [], "gone")


def test_a_node_of_several_agents_is_there_for_each(api: Api, seen: Seen) -> None:
    labels = {"robotkube.io/agent": "vehicle-00", "agent.robotkube.io/vehicle-01": "1"}
    api.post("/api/v1/nodes", {"apiVersion": "v1", "kind": "Node", "metadata": {"name": "n1", "labels": labels}})
    until(lambda: [node.agent for node in seen.cluster.nodes()] == ["vehicle-00", "vehicle-01"], "both seen")
    assert {node.name for node in seen.cluster.nodes()} == {"n1"}
    api.merge("/api/v1/nodes/n1", {"metadata": {"labels": {"agent.robotkube.io/vehicle-01": None}}})
    until(lambda: [node.agent for node in seen.cluster.nodes()] == ["vehicle-00"], "the guest is gone")
    api.delete("/api/v1/nodes/n1")
    until(lambda: seen.cluster.nodes() == [], "gone")


def test_nodes_of_agents(api: Api, seen: Seen) -> None:
    labels = {
        "robotkube.io/agent": "cloud-0",
        "robotkube.io/role": "cloud",
        "robotkube.io/capability.recording": "true",
    }
    api.post("/api/v1/nodes", {"apiVersion": "v1", "kind": "Node", "metadata": {"name": "n1", "labels": labels}})
    api.post("/api/v1/nodes", {"apiVersion": "v1", "kind": "Node", "metadata": {"name": "other"}})
    until(lambda: len(seen.cluster.nodes()) == 1, "node seen")
    [node] = seen.cluster.nodes()
    assert (node.agent, node.role, node.capabilities, node.ready) == ("cloud-0", "cloud", {"recording"}, False)
    ready = {"type": "Ready", "status": "True", "lastTransitionTime": "2026-11-21T10:00:00Z"}
    api.merge("/api/v1/nodes/n1/status", {"status": {"conditions": [ready]}})
    until(lambda: seen.cluster.nodes()[0].ready, "ready")
    until(lambda: seen.woken.count("nodes") == 2, "its coming and its readiness told")
    seen.woken.clear()
    heartbeat = {**ready, "lastHeartbeatTime": "2026-11-21T10:05:00Z"}
    api.merge("/api/v1/nodes/n1/status", {"status": {"conditions": [heartbeat]}})
    api.merge("/api/v1/nodes/n1", {"spec": {"unschedulable": True}})
    until(lambda: seen.cluster.nodes()[0].cordoned, "cordoned")
    until(lambda: seen.woken, "the cordon told")
    assert seen.woken == ["nodes"]
    for name in ("n1", "other"):
        api.delete(f"/api/v1/nodes/{name}")
    until(lambda: seen.cluster.nodes() == [], "gone")


def test_applications_and_pods_decide_what_is_observed(api: Api, seen: Seen) -> None:
    api.post(ARGOCD, application())
    until(lambda: seen.cluster.applications(), "application seen")
    shown = seen.cluster.applications()["cloud-0-mqtt-bridge"]
    assert judge_present(shown, "p1").annotated
    assert not judge_present(shown, "p1").synced
    done = application(
        sync={"status": "Synced", "comparedTo": {"source": SOURCE}},
        health={"status": "Healthy"},
        operationState={"phase": "Succeeded", "syncResult": {"source": SOURCE}},
    )
    api.merge(f"{ARGOCD}/cloud-0-mqtt-bridge", {"status": done["status"]})
    until(lambda: judge_present(seen.cluster.applications()["cloud-0-mqtt-bridge"], "p1").done, "observed")
    assert not judge_present(seen.cluster.applications()["cloud-0-mqtt-bridge"], "p2").annotated
    labels = {"robotkube.io/agent": "cloud-0", "app.kubernetes.io/instance": "mqtt-bridge"}
    pod = {"apiVersion": "v1", "kind": "Pod", "metadata": {"name": "b-0", "labels": labels}}
    api.post(
        "/api/v1/namespaces/cloud-0/pods",
        {**pod, "spec": {"nodeName": "n1", "containers": [{"name": "a", "image": "a:1"}]}},
    )
    until(lambda: [p.name for p in seen.cluster.pods("cloud-0/mqtt-bridge")] == ["b-0"], "pod seen")
    assert seen.cluster.pods("cloud-0/other") == []
    api.delete("/api/v1/namespaces/cloud-0/pods/b-0")
    api.delete(f"{ARGOCD}/cloud-0-mqtt-bridge")
    until(lambda: not seen.cluster.pods("cloud-0/mqtt-bridge") and not seen.cluster.applications(), "gone")


def test_a_server_that_goes_away_and_comes_back(api_server: ApiServerProcess, api: Api, seen: Seen) -> None:
    api.task("before")
    until(lambda: seen.task_names() == ["before"], "seen")
    api_server.stop_server()
    until(lambda: len(seen.cluster.complaints()) == 4, "complaints")
    with pytest.raises(UnavailableError):
        seen.cluster.patch_status("cloud-0", "before", {"plan": "p"})
    assert seen.task_names() == ["before"]
    api_server.start_server()
    api.task("after")
    until(lambda: seen.task_names() == ["after", "before"], "both seen")
    until(lambda: seen.cluster.complaints() == [], "no complaints")
    for name in ("before", "after"):
        api.delete(f"{TASKS}/{name}")


def test_what_stands_in_a_tasks_way_is_an_event_once(api: Api, seen: Seen) -> None:
    api.task("held")
    until(lambda: seen.task_names() == ["held"], "task seen")
    task = seen.cluster.tasks()[0]
    text = "the gate does not take this: é" + "x" * 2000
    seen.cluster.report_on_task(task, "ProposalRefused", text)
    seen.cluster.report_on_task(task, "ProposalRefused", text)
    seen.cluster.report_on_task(task, "GateUnavailable", "no verdict")
    path = "/apis/events.k8s.io/v1/namespaces/cloud-0/events"
    events = json.loads(call(api.client, "GET", path).data)["items"]
    about = [event for event in events if event["regarding"]["uid"] == task["metadata"]["uid"]]
    assert sorted(event["reason"] for event in about) == ["GateUnavailable", "ProposalRefused"]
    refused = next(event for event in about if event["reason"] == "ProposalRefused")
    assert refused["regarding"]["kind"] == "TaskDescription"
    assert refused["type"] == "Warning"
    assert text.startswith(refused["note"])
    assert len(refused["note"].encode()) <= 1024
    api.delete(f"{TASKS}/held")


def test_a_list_without_end_is_given_up(
    api: Api, api_server: ApiServerProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("a", "b", "c"):
        api.task(name)
    monkeypatch.setattr(kubernetes_client, "PAGE_OBJECTS", 1)
    monkeypatch.setattr(kubernetes_client, "PAGES_MAX", 2)
    client = api_client(str(api_server.kubeconfig))
    cluster = KubernetesCluster(client, "argocd", lambda what: None, time.time)
    cluster.start()
    try:
        until(lambda: any("more than 2 objects; remove old ones" in text for text in cluster.complaints()), "given up")
    finally:
        cluster.stop()
        client.rest_client.pool_manager.clear()
        for name in ("a", "b", "c"):
            api.delete(f"{TASKS}/{name}")


def test_errors_of_calls(api: Api) -> None:
    with pytest.raises(KeyError):
        call(api.client, "GET", f"{TASKS}/nothing")
    with pytest.raises(InputError, match="no access to a cluster"):
        api_client("/nowhere/kubeconfig")


def test_a_position_that_has_expired_is_listed_anew(api_server: ApiServerProcess, api: Api) -> None:
    """410 Gone: etcd has forgotten what came after the position, as after a long silence."""
    api.task("old")
    version = api.get(TASKS)["metadata"]["resourceVersion"]
    api.task("newer")
    api_server.compact()
    api_server.stop_server()
    api_server.start_server()
    until(lambda: serves_tasks(api), "tasks are served: a watch that meets another error first is listed anew for it")
    client = api_client(str(api_server.kubeconfig))
    seen: list[str] = []
    watch = ExpiredWatch(
        version, client, kubernetes_cluster.TASKS_PATH, "", dict, lambda key, before, now: seen.append(key)
    )
    watch.start()
    try:
        until(lambda: watch.lists > 1, "listed anew")
        until(lambda: sorted(seen) == ["cloud-0/newer", "cloud-0/old"], "both seen")
        api.task("newest")
        until(lambda: "cloud-0/newest" in watch.values(), "followed again")
        assert watch.complaint == ""
        assert any("410" in text or "too old" in text for text in watch.complaints)
    finally:
        watch.stop()
        client.rest_client.pool_manager.clear()
        for name in ("old", "newer", "newest"):
            api.delete(f"{TASKS}/{name}")


def serves_tasks(api: Api) -> bool:
    """Return whether the API server, which says before that it is ready, has opened the storage of tasks."""
    try:
        api.get(TASKS)
    except UnavailableError:
        return False
    return True


class ExpiredWatch(ResourceWatch):
    """Its first list ends at a position that the server no longer has."""

    def __init__(self, version: str, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.lists = 0
        self.complaints = []
        self._expired = version

    @property
    def complaint(self) -> str:
        return self.complaints[-1] if self.complaints else ""

    @complaint.setter
    def complaint(self, text: str) -> None:
        if hasattr(self, "complaints"):
            self.complaints.append(text)

    def _list(self) -> str:
        version = super()._list()
        self.lists += 1
        return version if self.lists > 1 else self._expired


def test_a_connection_that_breaks_in_the_middle_of_a_watch(api_server: ApiServerProcess, api: Api) -> None:
    """Nothing is lost of what happened meanwhile, and nothing is told twice."""
    client = api_client(str(api_server.kubeconfig))
    seen: list[tuple[str, bool]] = []
    watch = ResourceWatch(
        client, kubernetes_cluster.TASKS_PATH, "", dict, lambda key, before, now: seen.append((key, now is not None))
    )
    watch.start()
    try:
        assert watch.synced.wait(20)
        api.task("first")
        until(lambda: seen == [("cloud-0/first", True)], "seen")
        api_server.stop_server()
        api_server.start_server()
        api.delete(f"{TASKS}/first")
        api.task("second")
        until(lambda: len(seen) == 3, "both changes seen")
        assert sorted(seen[1:]) == [("cloud-0/first", False), ("cloud-0/second", True)]
    finally:
        watch.stop()
        client.rest_client.pool_manager.clear()
        api.delete(f"{TASKS}/second")
