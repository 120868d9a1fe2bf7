"""Argo CD for the embedded cluster: what `gitops.argocd.render` keeps, changes and refuses."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

from ci import toolchain
from gitops.argocd.render import CLIENTS, render

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
    [match] = [o for o in objects if o["kind"] == kind and o["metadata"]["name"] == name]
    return match


def pod(objects: list[Object], name: str) -> Object:
    [workload] = [o for o in objects if o["kind"] in {"Deployment", "StatefulSet"} and o["metadata"]["name"] == name]
    return dict(workload["spec"]["template"]["spec"])


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


def test_it_runs_where_the_platform_does(argocd: list[Object]) -> None:
    """On a Node that the platform shares it has another label."""
    assert pod(argocd, "argocd-redis")["nodeSelector"]["robotkube.io/role"] == "platform"
    [shared] = yaml.safe_load_all(render(WORKLOAD, IMAGES, {"enabled": False}, {"agent.robotkube.io/platform-0": "1"}))
    assert shared["spec"]["template"]["spec"]["nodeSelector"] == {"agent.robotkube.io/platform-0": "1"}


def test_its_workloads_say_their_version(argocd: list[Object]) -> None:
    """Images by digest do not; the module's own version is that of its manifests."""
    version = toolchain.module_dir("github.com/argoproj/argo-cd/v3").name.partition("@")[2]
    labels = {
        o["metadata"]["name"]: o["metadata"]["labels"] for o in argocd if o["kind"] in {"Deployment", "StatefulSet"}
    }
    said = {name: labelled.get("app.kubernetes.io/version") for name, labelled in labels.items()}
    assert said.pop("argocd-redis") is None
    assert set(said.values()) == {version}


def test_drops_what_is_not_used(argocd: list[Object]) -> None:
    names = " ".join(o["metadata"]["name"] for o in argocd)
    assert "dex" not in names
    assert "notifications" not in names


def test_its_policies_are_those_of_the_platforms_table(argocd: list[Object]) -> None:
    """Argo CD's own let every namespace in, and everything out."""
    policies = {o["metadata"]["name"]: o["spec"] for o in argocd if o["kind"] == "NetworkPolicy"}
    parts = {"redis", "repo-server", "argocd-server", "application-controller", "applicationset-controller"}
    assert set(policies) == {"default-deny", *parts}
    assert policies["default-deny"] == {"podSelector": {}, "policyTypes": ["Ingress", "Egress"]}
    pods = [o["spec"]["template"]["metadata"]["labels"] for o in argocd if "template" in o.get("spec", {})]
    for name in parts:
        selected = policies[name]["podSelector"]["matchLabels"].items()
        assert len([labels for labels in pods if selected <= labels.items()]) == 1, name


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
    assert "coordination.k8s.io" in data["resource.exclusions"]
    assert data["timeout.reconciliation"] == "300s"
    assert data["admin.enabled"] == "false"
    assert one(argocd, "ConfigMap", "argocd-cmd-params-cm")["data"]["server.insecure"] == "true"


def test_the_controller_reads_what_releases_are_made_of_and_watches_no_more(argocd: list[Object]) -> None:
    """A kind that it may not read would stop all releases if it were watched; one that settings leave out would not be
    refused: the rest of its release would be applied."""
    [role] = [o for o in argocd if o["kind"] == "ClusterRole"]
    [binding] = [o for o in argocd if o["kind"] == "ClusterRoleBinding"]
    account = {"kind": "ServiceAccount", "name": "argocd-application-controller", "namespace": "argocd"}
    assert (binding["roleRef"]["name"], binding["subjects"]) == (role["metadata"]["name"], [account])
    readable = {(group, kind) for rule in role["rules"] for group in rule["apiGroups"] for kind in rule["resources"]}
    assert readable == {("", "configmaps"), ("", "pods"), ("apps", "deployments"), ("apps", "replicasets")}
    assert {tuple(rule["verbs"]) for rule in role["rules"]} == {("get", "list", "watch")}
    settings = one(argocd, "ConfigMap", "argocd-cm")["data"]
    assert settings["resource.respectRBAC"] == "normal"
    assert "resource.inclusions" not in settings


def test_other_accounts_have_rights_in_their_namespace_only(argocd: list[Object]) -> None:
    """As Argo CD's own namespace-install.yaml gives them."""
    source = toolchain.module_dir("github.com/argoproj/argo-cd/v3") / "manifests" / "namespace-install.yaml"
    given = {
        o["metadata"]["name"]: o["rules"]
        for o in yaml.load_all(source.read_text(encoding="utf-8"), Loader=yaml.CSafeLoader)
        if o and o["kind"] == "Role"
    }
    roles = {o["metadata"]["name"]: o["rules"] for o in argocd if o["kind"] == "Role"}
    assert set(roles) == {
        "argocd-application-controller",
        "argocd-applicationset-controller",
        "argocd-redis",
        "argocd-server",
    }
    assert roles == {name: given[name] for name in roles}


def test_no_secret_is_a_variable_but_one_that_a_container_waits_for(argocd: list[Object]) -> None:
    pods = {
        one["metadata"]["name"]: one["spec"]["template"]["spec"] for one in argocd if "template" in one.get("spec", {})
    }
    variables = {
        (name, variable["name"])
        for name, spec in pods.items()
        for container in [*spec.get("initContainers", []), *spec["containers"]]
        for variable in container.get("env", [])
        if "secretKeyRef" in variable.get("valueFrom", {})
    }
    assert variables == {("argocd-applicationset-controller", "ROBOTKUBE_START_AFTER_SERVER_KEY")}


def test_its_cache_and_who_asks_it_read_the_password_from_a_file(argocd: list[Object]) -> None:
    """The cache's own pod begins before the file is there: an init container of it makes the Secret."""
    folder = "/etc/argocd-redis"
    for part in ("application-controller", "redis", "repo-server", "server"):
        spec = pod(argocd, f"argocd-{part}")
        [container] = spec["containers"]
        [mount] = [one for one in container["volumeMounts"] if one["mountPath"] == folder]
        [volume] = [one for one in spec["volumes"] if one["name"] == mount["name"]]
        expected = {"secretName": "argocd-redis", "items": [{"key": "auth", "path": "auth"}]}
        assert volume["secret"] == {**expected, "optional": part == "redis"}, part
        values = {one["name"]: one.get("value") for one in container["env"]}
        assert values.get("REDIS_CREDS_DIR_PATH") == (None if part == "redis" else folder), part


def cache_starts(argocd: list[Object], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run the cache's command on a folder, with programs there that say what they were told, and do not wait."""
    [container] = pod(argocd, "argocd-redis")["containers"]
    assert container["args"] == []
    for name, script in (("redis-server", 'echo "$@"\ncat'), ("sleep", "exit 0")):
        (folder / name).write_text(f"#!/bin/sh\n{script}\n")
        (folder / name).chmod(0o755)
    [shell, option, program] = container["command"]
    command = [shell, option, program.replace("/etc/argocd-redis", str(folder))]
    environment = {"PATH": f"{folder}:{os.environ['PATH']}"}
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=60)


@pytest.mark.parametrize(
    ("password", "written"), [("some-word", "some-word"), ('a "b" $c \\ #d', 'a \\"b\\" $c \\\\ #d')]
)
def test_its_cache_gets_the_password_as_settings(
    argocd: list[Object], password: str, written: str, tmp_path: Path
) -> None:
    """Not as an argument: those of all processes of a machine can be listed."""
    (tmp_path / "auth").write_text(password)
    done = cache_starts(argocd, tmp_path)
    assert done.stdout.splitlines() == ["-", 'save ""', "appendonly no", f'requirepass "{written}"']


@pytest.mark.parametrize("content", [None, ""])
def test_its_cache_does_not_start_without_a_password(argocd: list[Object], content: str | None, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / "auth").write_text(content)
    done = cache_starts(argocd, tmp_path)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.endswith("after a minute: Secret argocd-redis has no key auth\n")


def test_a_container_holds_a_token_only_if_it_asks_the_api_server(argocd: list[Object]) -> None:
    pods = {
        o["metadata"]["name"]: pod(argocd, o["metadata"]["name"]) for o in argocd if "template" in o.get("spec", {})
    }
    assert {name for name, spec in pods.items() if spec.get("automountServiceAccountToken", True)} == {
        "argocd-application-controller",
        "argocd-applicationset-controller",
        "argocd-server",
    }
    holding = {
        container["name"]: mount["mountPath"]
        for spec in pods.values()
        for container in [*spec.get("initContainers", []), *spec["containers"]]
        for mount in container.get("volumeMounts", [])
        if mount["name"] in token_volumes(spec)
    }
    assert holding == {"secret-init": "/var/run/secrets/kubernetes.io/serviceaccount"}


def test_no_program_starts_without_the_certificate_of_the_repo_servers_clients(argocd: list[Object]) -> None:
    workloads = [o["metadata"]["name"] for o in argocd if o["kind"] in {"Deployment", "StatefulSet"}]
    volumes = {name: pod(argocd, name).get("volumes", []) for name in workloads}
    secrets = {
        name: volume["secret"]
        for name, listed in volumes.items()
        for volume in listed
        if volume["name"] == "argocd-repo-server-mtls"
    }
    assert set(secrets) == set(workloads) - {"argocd-redis"}
    assert {secret["optional"] for secret in secrets.values()} == {False}
    asked = {name: {item["key"] for item in secret["items"]} for name, secret in secrets.items()}
    assert asked.pop("argocd-repo-server") == {"client-ca.crt"}
    assert set(map(frozenset, asked.values())) == {frozenset({"client.crt", "client.key"})}


def token_volumes(spec: Object) -> set[str]:
    """Names of the volumes that hold a token of the pod's account."""
    sources = {volume["name"]: volume.get("projected", {}).get("sources", []) for volume in spec.get("volumes", [])}
    return {name for name, parts in sources.items() if any("serviceAccountToken" in part for part in parts)}


def test_brings_nothing_that_the_installer_makes_once(argocd: list[Object]) -> None:
    """So installing again leaves it: charts/test_argocd_processes.py."""
    assert [o for o in argocd if o["metadata"]["name"] == CLIENTS] == []


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
    assert next(yaml.safe_load_all(render(text, IMAGES))) == {
        "apiVersion": "v1",
        "kind": "ServiceAccount",
        "metadata": {"name": "argocd-server", "namespace": "argocd", "labels": {"a": "b"}},
    }
