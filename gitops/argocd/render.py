"""Turns Argo CD's own `manifests/install.yaml` into the installation that comes with the platform.

`render` decides which objects stay and how each workload runs on a small machine; it changes nothing else, so a newer
Argo CD needs no change here unless it renames a workload or an image, and then says so.

    python3 -m gitops.argocd.render --manifests .../manifests/install.yaml --images images.yaml > argocd.yaml

As the chart's defaults, its policies name nobody's addresses: `--values` does, with the file that Helm gets.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml

from gitops.argocd import network

Object = dict[str, Any]

NOTHING: Mapping[str, Any] = MappingProxyType({})
NAMESPACE = "argocd"
CLUSTER_KINDS = {"CustomResourceDefinition", "ClusterRole", "ClusterRoleBinding", "Namespace"}
# Single sign-on and notifications are not used. NetworkPolicies: those of the platform's table instead, which name who
# asks; Argo CD's own let every namespace in, and everything out.
DROPPED_PARTS = ("dex", "notifications")
DROPPED_KINDS = {"NetworkPolicy"}
IMAGES = {"quay.io/argoproj/argocd": "argocd", "public.ecr.aws/docker/library/redis": "redis"}
# Images by digest do not say which Argo CD runs; `robotkube preflight` reads it here.
VERSION_LABEL = "app.kubernetes.io/version"
PLATFORM_NODES: Mapping[str, str] = MappingProxyType({"robotkube.io/role": "platform"})
TOLERATIONS = [{"key": "robotkube.io/role", "operator": "Equal", "value": "platform", "effect": "NoSchedule"}]
# Requests are small and there is no CPU limit: all of it stands on the way from a commit to its pods.
RESOURCES: dict[str, tuple[str, str, str]] = {  # container -> CPU and memory requested, memory limit
    "argocd-application-controller": ("150m", "256Mi", "1Gi"),
    "argocd-applicationset-controller": ("50m", "64Mi", "384Mi"),
    "argocd-repo-server": ("100m", "128Mi", "1Gi"),
    "argocd-server": ("50m", "64Mi", "384Mi"),
    "redis": ("20m", "16Mi", "128Mi"),
    "copyutil": ("10m", "16Mi", "256Mi"),
    "secret-init": ("10m", "16Mi", "256Mi"),
}
# What releases are made of, and what grows from it: group -> resources. The application controller may read these and
# no others; what it may not read it does not watch (`resource.respectRBAC`). No other kind is overlooked: nothing of a
# release that holds one is applied.
READ: dict[str, list[str]] = {"": ["configmaps", "pods"], "apps": ["deployments", "replicasets"]}
# The one account with rights outside of its namespace, and its ClusterRole. What it writes, it writes by a Role in each
# agent's namespace, which charts/robotkube makes.
READER = "argocd-application-controller"
READER_RULES: list[Object] = [
    {"apiGroups": [group], "resources": resources, "verbs": ["get", "list", "watch"]}
    for group, resources in READ.items()
]
SETTINGS: dict[str, dict[str, str]] = {
    "argocd-cm": {
        "resource.respectRBAC": "normal",
        "admin.enabled": "false",  # nobody uses this account, and without it no password of it is made
        "application.resourceTrackingMethod": "annotation",
        # Charts are pinned by digest and Git notifies by its hook: polling is only the fallback, and one at a time.
        "timeout.reconciliation": "300s",
        "timeout.reconciliation.jitter": "60s",
    },
    "argocd-cmd-params-cm": {
        "server.insecure": "true",
        "controller.status.processors": "10",
        "controller.operation.processors": "5",
        "controller.kubectl.parallelism.limit": "5",
        # A chart's OCI registry that goes away in the middle of an answer holds its releases for that long.
        "controller.repo.server.timeout.seconds": "15",
        # Each rendering is a process of 0.1 core seconds: two that are ready early are better than four that are late.
        "reposerver.parallelism.limit": "2",
        "reposerver.git.request.timeout": "5s",
    },
}
# Full names of Services are asked for as they are, not below each of the search path's domains before.
NAMES: Object = {"options": [{"name": "ndots", "value": "2"}]}
READINESS = {"initialDelaySeconds": 1, "periodSeconds": 5}
# The controller serves its hook only if argocd-server has made this key before; kubelet starts the container once the
# key is there.
SERVER_KEY = {
    "name": "ROBOTKUBE_START_AFTER_SERVER_KEY",
    "valueFrom": {"secretKeyRef": {"name": "argocd-secret", "key": "server.secretkey"}},
}
# Less collecting of garbage while memory is there, as much as is needed towards the limit.
COLLECTING = [{"name": "GOGC", "value": "400"}]
LARGE, SMALL = ([*COLLECTING, {"name": "GOMEMLIMIT", "value": limit}] for limit in ("800MiB", "300MiB"))
# A forge that goes away in the middle of an answer holds all releases for that long: 90 s by default.
IMPATIENT = [{"name": "ARGOCD_EXEC_TIMEOUT", "value": "10s"}]
ENVIRONMENT: dict[str, list[Object]] = {
    "argocd-application-controller": LARGE,
    "argocd-applicationset-controller": [SERVER_KEY, *SMALL],
    "argocd-repo-server": [{"name": "ARGOCD_GPG_ENABLED", "value": "false"}, *IMPATIENT, *LARGE],
    "argocd-server": [{"name": "ARGOCD_GPG_ENABLED", "value": "false"}, *SMALL],
}
# The Secret with the one certificate that the repo-server's clients show: client-ca.crt for it, client.crt and
# client.key for them. Who installs makes it before; a program that started without it would answer, or ask, without.
CLIENTS = "argocd-repo-server-mtls"
CLIENTS_KEYS = {"client-ca.crt", "client.crt", "client.key"}
# The password of Argo CD's cache: a Secret that an init container of the cache makes, read from a file by everybody.
# Where it is made, its file comes later than the pod; the program gets it as settings, not as an argument, which
# whoever lists a machine's processes reads.
CACHE, PASSWORD, PASSWORD_FOLDER = "argocd-redis", "REDIS_PASSWORD", "/etc/argocd-redis"
PASSWORD_FILE = {"name": "REDIS_CREDS_DIR_PATH", "value": PASSWORD_FOLDER}
CACHE_PROGRAM = rf"""
looks=0
until [ -s {PASSWORD_FOLDER}/auth ]; do
  if [ $((looks += 1)) -gt 300 ]; then
    echo "no password in {PASSWORD_FOLDER}/auth after a minute: Secret {CACHE} has no key auth" >&2
    exit 1
  fi
  sleep 0.2
done
password=$(sed 's/[\\"]/\\&/g' {PASSWORD_FOLDER}/auth)
exec redis-server - <<settings
save ""
appendonly no
requirepass "$password"
settings
""".lstrip()
# Workloads whose account is needed by one init container alone: this one gets the token, what runs afterwards does not.
TOKEN_WHILE_STARTING = {"argocd-redis": "secret-init"}
TOKEN_FOLDER = "/var/run/secrets/kubernetes.io/serviceaccount"  # noqa: S105 - where every client looks for it
TOKEN_SECONDS = 3607
# As kubelet mounts it by itself, but that is into every container.
TOKEN: Object = {
    "name": "service-account-token",
    "projected": {
        "sources": [
            {"serviceAccountToken": {"path": "token", "expirationSeconds": TOKEN_SECONDS}},
            {"configMap": {"name": "kube-root-ca.crt", "items": [{"key": "ca.crt", "path": "ca.crt"}]}},
            {"downwardAPI": {"items": [{"path": "namespace", "fieldRef": {"fieldPath": "metadata.namespace"}}]}},
        ]
    },
}


def render(
    manifests: str,
    images: Mapping[str, str],
    network_policies: Mapping[str, Any] = NOTHING,
    nodes: Mapping[str, str] = PLATFORM_NODES,
    forge: str = "",
) -> str:
    """The manifests to apply, as YAML.

    `manifests` is the text of Argo CD's install.yaml; `images` maps `argocd` and `redis` to references (further keys
    are ignored); `network_policies` are the values of this name that the platform's chart gets, `nodes` the labels of
    the Nodes that it is to run on, `forge` the URL of one of others (`external_forge`). Raises ValueError when a
    reference is missing or a workload is not one this module knows.
    """
    missing = [name for name in IMAGES.values() if not images.get(name)]
    if missing:
        raise ValueError(f"Argo CD: no image reference for {', '.join(missing)}; add them to the images file")
    documents = filter(None, yaml.load_all(manifests, Loader=_LOADER))
    objects = [*_rendered(documents, images, nodes), *network.policies(NAMESPACE, network_policies, forge)]
    return yaml.dump_all(objects, Dumper=_DUMPER, sort_keys=True)


def external_forge(values: Mapping[str, Any]) -> str:
    """The URL of a forge of others in values of the platform's chart; empty where it brings one."""
    forge = values.get("forge") or {}
    return str((forge.get("external") or {}).get("url") or "") if forge.get("kind") == "external" else ""


def _rendered(documents: Iterator[Object], images: Mapping[str, str], nodes: Mapping[str, str]) -> Iterator[Object]:
    for document in documents:
        if not _kept(document):
            continue
        if document["kind"] not in CLUSTER_KINDS:
            document["metadata"]["namespace"] = NAMESPACE
        if document["kind"] == "ConfigMap" and document["metadata"]["name"] in SETTINGS:
            document["data"] = {**document.get("data", {}), **SETTINGS[document["metadata"]["name"]]}
        if document["kind"] == "ClusterRole":
            document["rules"] = READER_RULES
        if document["kind"] in {"Deployment", "StatefulSet"}:
            _adapt_workload(document, images, nodes)
        yield document


def _kept(document: Object) -> bool:
    name: str = document["metadata"]["name"]
    if document["kind"] in {"ClusterRole", "ClusterRoleBinding"}:
        return name == READER
    return document["kind"] not in DROPPED_KINDS and not any(part in name for part in DROPPED_PARTS)


def _adapt_workload(workload: Object, images: Mapping[str, str], nodes: Mapping[str, str]) -> None:
    name = workload["metadata"]["name"]
    pod = workload["spec"]["template"]["spec"]
    if version := _version(pod):
        workload["metadata"].setdefault("labels", {})[VERSION_LABEL] = version
    pod["nodeSelector"] = {**pod.get("nodeSelector", {}), **nodes}
    pod["tolerations"] = [*pod.get("tolerations", []), *TOLERATIONS]
    pod["dnsConfig"] = NAMES
    for volume in pod.get("volumes", []):
        if volume["name"] == CLIENTS:
            items = [item for item in volume["secret"]["items"] if item["key"] in CLIENTS_KEYS]
            volume["secret"].update(items=items, optional=False)
    pod.pop("affinity", None)  # one node: spreading is work for the scheduler and no gain
    for container in [*pod.get("initContainers", []), *pod["containers"]]:
        _adapt_container(name, container, images)
    _read_password_from_file(name, pod)
    if name in TOKEN_WHILE_STARTING:
        _withhold_token(pod, TOKEN_WHILE_STARTING[name])


def _version(pod: Object) -> str:
    """The tag of Argo CD's image in a pod that runs it; empty for another pod."""
    for container in pod["containers"]:
        repository, _, tag = container["image"].partition("@")[0].rpartition(":")
        if IMAGES.get(repository) == "argocd":
            return str(tag)
    return ""


def _read_password_from_file(workload: str, pod: Object) -> None:
    """Who has the cache's password as a variable gets it as a file."""
    for container in pod["containers"]:
        variables = [one for one in container["env"] if one["name"] != PASSWORD]
        if len(variables) == len(container["env"]):
            continue
        makes_it = workload == CACHE
        container["env"] = variables if makes_it else [*variables, PASSWORD_FILE]
        if makes_it:
            container.update(command=["sh", "-ec", CACHE_PROGRAM], args=[])
        mount = {"name": CACHE, "mountPath": PASSWORD_FOLDER, "readOnly": True}
        container["volumeMounts"] = [*container.get("volumeMounts", []), mount]
        secret = {"secretName": CACHE, "items": [{"key": "auth", "path": "auth"}], "optional": makes_it}
        pod["volumes"] = [*pod.get("volumes", []), {"name": CACHE, "secret": secret}]


def _withhold_token(pod: Object, container: str) -> None:
    """The token of the pod's account goes to this init container alone."""
    pod["automountServiceAccountToken"] = False
    pod["volumes"] = [*pod.get("volumes", []), TOKEN]
    [starting] = [one for one in pod.get("initContainers", []) if one["name"] == container]
    mount = {"name": TOKEN["name"], "mountPath": TOKEN_FOLDER, "readOnly": True}
    starting["volumeMounts"] = [*starting.get("volumeMounts", []), mount]


def _adapt_container(workload: str, container: Object, images: Mapping[str, str]) -> None:
    repository = container["image"].rsplit("@", 1)[0].rsplit(":", 1)[0]
    if repository not in IMAGES or container["name"] not in RESOURCES:
        raise ValueError(
            f"Argo CD: {workload} has container {container['name']} of image {container['image']}, "
            "unknown to gitops/argocd/render.py; add it to IMAGES and RESOURCES there"
        )
    container["image"] = images[IMAGES[repository]]
    container["imagePullPolicy"] = "IfNotPresent"
    cpu, memory, memory_limit = RESOURCES[container["name"]]
    container["resources"] = {"requests": {"cpu": cpu, "memory": memory}, "limits": {"memory": memory_limit}}
    container["env"] = [*container.get("env", []), *ENVIRONMENT.get(container["name"], [])]
    if "readinessProbe" in container:
        container["readinessProbe"].update(READINESS)


# 34 000 lines: 0.6 s in C, 9 s in Python. Looked up here as in robotkube's yaml_codec: gitops imports nothing of ours.
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _PlainDumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
    """Writes every value in full: shared settings must not become YAML aliases, which some readers refuse."""

    def ignore_aliases(self, data: object) -> bool:
        return True


_DUMPER = _PlainDumper


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="gitops.argocd.render", description="Argo CD's manifests, as the platform needs it"
    )
    parser.add_argument("--manifests", type=Path, required=True, help="Argo CD's manifests/install.yaml")
    parser.add_argument("--images", type=Path, required=True, help="YAML: {images: {argocd: <reference>, redis: ...}}")
    parser.add_argument("--values", type=Path, help="YAML: values of the platform's chart")
    arguments = parser.parse_args()
    images = yaml.safe_load(arguments.images.read_text(encoding="utf-8"))["images"]
    values = yaml.safe_load(arguments.values.read_text(encoding="utf-8")) if arguments.values else {}
    stated = values.get("networkPolicies") or {}
    try:
        manifests = arguments.manifests.read_text(encoding="utf-8")
        sys.stdout.write(render(manifests, images, stated, forge=external_forge(values)))
    except ValueError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
