"""Argo CD for the embedded cluster: what `gitops.argocd.render` keeps, changes and refuses."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from gitops.argocd.render import render

pytestmark = pytest.mark.toolchain

Object = dict[str, Any]

IMAGES = {"argocd": "registry.example/argocd@sha256:1", "redis": "registry.example/redis@sha256:2", "ros": "unused"}
WORKLOAD = """\
apiVersion: apps/v1
kind: Deployment
metadata: {name: argocd-server}
spec: {template: {spec: {containers: [{name: argocd-server, image: "quay.io/argoproj/argocd:v3"}]}}}
"""


def one(objects: list[Object], kind: str, name: str) -> Object:
    [found] = [o for o in objects if o["kind"] == kind and o["metadata"]["name"] == name]
    return found


def pod(objects: list[Object], name: str) -> Object:
    [found] = [o for o in objects if o["kind"] in {"Deployment", "StatefulSet"} and o["metadata"]["name"] == name]
    return dict(found["spec"]["template"]["spec"])


def test_runs_five_workloads_with_our_images_on_the_platform_node(argocd: list[Object]) -> None:
    workloads = {o["metadata"]["name"] for o in argocd if o["kind"] in {"Deployment", "StatefulSet"}}
    assert workloads == {
        "argocd-application-controller",
        "argocd-applicationset-controller",
        "argocd-redis",
        "argocd-repo-server",
        "argocd-server",
    }
    for name in workloads:
        spec = pod(argocd, name)
        assert spec["nodeSelector"]["robotkube.io/role"] == "platform"
        assert spec["tolerations"][0]["effect"] == "NoSchedule"
        assert spec["dnsConfig"] == {"options": [{"name": "ndots", "value": "2"}]}
        for container in [*spec.get("initContainers", []), *spec["containers"]]:
            assert container["image"].startswith("registry.example/"), name
            assert container["imagePullPolicy"] == "IfNotPresent"
            assert {"requests", "limits"} <= set(container["resources"])


def test_drops_what_is_not_used(argocd: list[Object]) -> None:
    names = " ".join(o["metadata"]["name"] for o in argocd)
    assert "dex" not in names
    assert "notifications" not in names
    assert not [o for o in argocd if o["kind"] == "NetworkPolicy"]


def test_puts_everything_into_the_namespace(argocd: list[Object]) -> None:
    cluster = {"CustomResourceDefinition", "ClusterRole", "ClusterRoleBinding"}
    assert {o["metadata"].get("namespace") for o in argocd if o["kind"] not in cluster} == {"argocd"}
    assert {o["metadata"].get("namespace") for o in argocd if o["kind"] in cluster} == {None}


def test_the_application_set_controller_starts_once_its_hook_can_be_served(argocd: list[Object]) -> None:
    [container] = pod(argocd, "argocd-applicationset-controller")["containers"]
    reference = {"name": "argocd-secret", "key": "server.secretkey"}
    assert {"secretKeyRef": reference} in [variable.get("valueFrom") for variable in container["env"]]


def test_leaves_to_the_bootstrap_job_what_it_patches(argocd: list[Object]) -> None:
    assert "data" not in one(argocd, "Secret", "argocd-secret")
    assert "data" not in one(argocd, "ConfigMap", "argocd-rbac-cm")
    assert not [key for key in one(argocd, "ConfigMap", "argocd-cm")["data"] if key.startswith("accounts")]


def test_keeps_what_the_manifests_set(argocd: list[Object]) -> None:
    data = one(argocd, "ConfigMap", "argocd-cm")["data"]
    excluded = {(tuple(e["apiGroups"]), *e["kinds"]) for e in yaml.safe_load(data["resource.exclusions"])}
    assert {(("coordination.k8s.io",), "Lease"), (("argoproj.io", "robotkube.io"), "*"), (("",), "Node")} <= excluded
    assert data["timeout.reconciliation"] == "300s"
    assert one(argocd, "ConfigMap", "argocd-cmd-params-cm")["data"]["server.insecure"] == "true"


def test_refuses_a_missing_image() -> None:
    with pytest.raises(ValueError, match=r"no image reference for redis; add them to the images file"):
        render(WORKLOAD, {"argocd": "x"})


@pytest.mark.parametrize(
    ("old", "new"),
    [("quay.io/argoproj/argocd:v3", "ghcr.io/other:1"), ("name: argocd-server, image", "name: x, image")],
)
def test_refuses_a_workload_it_does_not_know(old: str, new: str) -> None:
    with pytest.raises(ValueError, match=r"unknown to gitops/argocd/render\.py; add it to IMAGES and RESOURCES there"):
        render(WORKLOAD.replace(old, new), IMAGES)


def test_keeps_other_objects_as_they_are() -> None:
    text = "apiVersion: v1\nkind: ServiceAccount\nmetadata: {name: argocd-server, labels: {a: b}}\n"
    assert yaml.safe_load(render(text, IMAGES)) == {
        "apiVersion": "v1",
        "kind": "ServiceAccount",
        "metadata": {"name": "argocd-server", "namespace": "argocd", "labels": {"a": "b"}},
    }
