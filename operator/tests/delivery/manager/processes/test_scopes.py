"""A manager of few namespaces on a real API server, holds on Nodes, and what is reported about Nodes."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime

import pytest

from robotkube.delivery.manager.adapters.kubernetes_cluster import KubernetesCluster
from robotkube.delivery.tasks.core.holds import HOLD_SECONDS_MAX, DeviceHold
from robotkube.foundation.kubernetes.adapters.client import api_client
from tests.stages.kubernetes.api_calls import TASKS, Api
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

EVENTS = "/apis/events.k8s.io/v1/namespaces/argocd/events"


@contextmanager
def watching(api_server: ApiServerProcess, woken: list[str], *namespaces: str) -> Iterator[KubernetesCluster]:
    """The cluster as a manager of these namespaces reads it."""
    cluster = KubernetesCluster(api_client(str(api_server.kubeconfig)), "argocd", woken.append, time.time, namespaces)
    cluster.start()
    assert cluster.wait_until_synced(20)
    yield cluster
    cluster.stop()


def names(cluster: KubernetesCluster) -> list[str]:
    return [task["metadata"]["name"] for task in cluster.tasks()]


def test_only_the_namespaces_of_the_scope_are_seen(api_server: ApiServerProcess, api: Api) -> None:
    with watching(api_server, []) as everything, watching(api_server, [], "argocd", "default") as scoped:
        api.task("elsewhere")
        until(lambda: names(everything), "task seen by whoever sees everything")
        assert names(everything) == ["elsewhere"]
        assert names(scoped) == []
        path = "/apis/robotkube.io/v1alpha1/namespaces/default/taskdescriptions"
        kind = {"apiVersion": "robotkube.io/v1alpha1", "kind": "TaskDescription"}
        api.post(path, {**kind, "metadata": {"name": "here"}, "spec": everything.tasks()[0]["spec"]})
        until(lambda: names(scoped) == ["here"], "task of the scope seen")
        for gone in (f"{path}/here", f"{TASKS}/elsewhere"):
            api.delete(gone)
        until(lambda: names(everything) == names(scoped) == [], "gone")


def test_a_nodes_hold_is_seen_wakes_the_manager_and_ends(api_server: ApiServerProcess, api: Api) -> None:
    woken: list[str] = []
    with watching(api_server, woken) as cluster:
        api.node("v1", "vehicle")
        until(lambda: [node.ready for node in cluster.nodes()] == [True], "node seen")
        until(lambda: woken.count("nodes") == 2, "its coming and its readiness told")
        woken.clear()
        hold_and_release(api, cluster, woken)
        api.delete("/api/v1/nodes/v1")
        until(lambda: cluster.nodes() == [], "gone")


def hold_and_release(api: Api, cluster: KubernetesCluster, woken: list[str]) -> None:
    def say(**annotations: str | None) -> None:
        keys = {f"robotkube.io/{key.replace('_', '-')}": text for key, text in annotations.items()}
        api.merge("/api/v1/nodes/v1", {"metadata": {"annotations": keys}})

    def held() -> DeviceHold | None:
        return cluster.nodes()[0].hold

    before = int(time.time())  # what the API server notes has no parts of a second
    until_time = datetime.fromtimestamp(before + 60, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    say(hold="driving", hold_until=until_time)
    until(lambda: held() is not None, "hold seen")
    until(lambda: woken, "hold told")
    assert woken == ["nodes"]
    hold = held()
    assert hold is not None
    assert (hold.reason, hold.text.partition(": ")[0]) == ("driving", f"v1 holds changes until {until_time}")
    say(hold_until=None)
    until(lambda: held() not in (hold, None), "hold without an end")
    endless = held()
    assert endless is not None
    assert before <= endless.until_ns / 1e9 - HOLD_SECONDS_MAX <= time.time(), "counted from when it was set"
    say(hold=None)
    until(lambda: held() is None, "released")


def test_a_report_on_a_node_is_written_into_the_platforms_namespace_once(
    api_server: ApiServerProcess, api: Api
) -> None:
    client = api_client(str(api_server.kubeconfig))
    clusters = [KubernetesCluster(client, "argocd", lambda what: None, time.time, home="argocd") for _ in range(2)]
    for cluster in (*clusters, clusters[0]):
        cluster.report_on_node("stranger", "UnknownAgent", "Node stranger says it is agent 'x', which is not declared")
    about = [event for event in api.get(EVENTS)["items"] if event["regarding"].get("name") == "stranger"]
    assert [(event["reason"], event["type"], event["regarding"]["kind"]) for event in about] == [
        ("UnknownAgent", "Warning", "Node")
    ]
