"""What a cluster is given back with counts as before, or as changed, when all of its objects are compared."""

from __future__ import annotations

import copy
import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.stages.platform import lent_cluster
from tests.stages.platform.lent_cluster import LentCluster

DEPLOYMENT = {"kind": "Deployment", "name": "server", "controller": True}
SET = {"kind": "ReplicaSet", "name": "server-1", "controller": True}
SETTINGS = {"metadata": {"namespace": "argocd", "name": "argocd-cm"}, "data": {"url": "https://a"}}
POD: dict[str, Any] = {
    "metadata": {"namespace": "argocd", "name": "server-1-abc", "generateName": "server-1-", "ownerReferences": [SET]},
    "spec": {"nodeName": "worker", "containers": [{"image": "argocd@sha256:1"}]},
    "status": {"phase": "Running"},
}
SETS = [
    {"metadata": {"namespace": "argocd", "name": name, "ownerReferences": [DEPLOYMENT]}, "spec": {"replicas": replicas}}
    for name, replicas in (("server-1", 1), ("server-2", 1))
]
KINDS = {"configmaps": [SETTINGS], "pods": [POD], "replicasets.apps": SETS}


class Served(LentCluster):
    """One whose API server is a mapping: `objects` by kind."""

    objects: dict[str, list[dict[str, Any]]]

    def ask(self, *words: str, text: str | None = None, seconds: float = 0) -> str:
        if words[0] == "api-resources":
            return "\n".join([*self.objects, "events", "leases.coordination.k8s.io"])
        assert words[1] in self.objects, f"{words[1]} comes and goes, and is not asked for"
        return json.dumps({"items": self.objects[words[1]]})


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Served:
    def no_command(*command: str, seconds: float) -> subprocess.CompletedProcess[str]:
        raise AssertionError(command)

    monkeypatch.setattr(lent_cluster, "SETTLE_SECONDS_MAX", 0)
    served = Served((), Path(), "", Path(), Path(), no_command)
    object.__setattr__(served, "objects", copy.deepcopy(KINDS))
    return served


def difference(cluster: Served, before: dict[str, Any]) -> str:
    with pytest.raises(AssertionError) as failed:
        lent_cluster.require_as_before(cluster, before)
    return str(failed.value)


def test_a_restarted_deployment_is_as_before(cluster: Served) -> None:
    before = lent_cluster.settled_objects(cluster)
    [pod], (first, _) = cluster.objects["pods"], cluster.objects["replicasets.apps"]
    pod["metadata"]["name"] = "server-1-xyz"
    pod["spec"]["nodeName"] = "worker2"
    pod["status"] = {}
    first["metadata"]["annotations"] = {"deployment.kubernetes.io/revision": "3"}
    passed = {"namespace": "argocd", "name": "server-3", "ownerReferences": [DEPLOYMENT]}
    cluster.objects["replicasets.apps"].append({"metadata": passed, "spec": {"replicas": 0}})
    lent_cluster.require_as_before(cluster, before)


@pytest.mark.parametrize(
    ("kind", "change", "words"),
    [
        ("configmaps", {"data": {"url": "https://b"}}, "configmaps argocd/argocd-cm"),
        ("configmaps", {"metadata": {**SETTINGS["metadata"], "labels": {"a": "b"}}}, "configmaps argocd/argocd-cm"),
        ("configmaps", {"metadata": {"namespace": "argocd", "name": "other"}}, "configmaps argocd/other"),
        ("pods", {"spec": {"containers": [{"image": "argocd@sha256:2"}]}}, "pods argocd/server-1-0"),
        ("replicasets.apps", {"spec": {"replicas": 2}}, "replicasets.apps argocd/server-1"),
    ],
)
def test_a_changed_object_is_named(cluster: Served, kind: str, change: dict[str, Any], words: str) -> None:
    before = lent_cluster.settled_objects(cluster)
    cluster.objects[kind][0].update(change)
    assert words in difference(cluster, before)


def test_objects_that_come_or_go_are_named(cluster: Served) -> None:
    before = lent_cluster.settled_objects(cluster)
    cluster.objects["pods"].append(POD)
    cluster.objects["configmaps"].clear()
    said = difference(cluster, before)
    assert "pods argocd/server-1-1" in said
    assert "configmaps argocd/argocd-cm" in said


def test_another_image_than_the_bundles_is_named(cluster: Served) -> None:
    bundled = {name: f"sha256:{name}" for name in lent_cluster.EXPECTED_TO_RUN}
    forge = {"mqtt-bridge", "event-detector"}
    pods = []
    for name, digest in bundled.items():
        place = lent_cluster.FORGE if name in forge else cluster.place
        status = {"containerStatuses": [{"imageID": f"{place}/{name}@{digest}"}]}
        pods.append({"metadata": {"namespace": "robotkube"}, "status": status})
    own = {"metadata": {"namespace": "kube-system"}, "status": {"containerStatuses": [{"imageID": "sha256:theirs"}]}}
    cluster.objects["pods"] = [*pods, own]
    lent_cluster.require_digests(cluster, bundled, ("kube-system",))
    with pytest.raises(AssertionError):
        lent_cluster.require_digests(cluster, bundled)
    with pytest.raises(AssertionError):
        lent_cluster.require_digests(cluster, {**bundled, "gitea": "sha256:other"}, ("kube-system",))
