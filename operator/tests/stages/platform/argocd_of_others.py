"""An Argo CD that is there before the platform: its project's own `install.yaml`, applied by kubectl as its guide says,
with the images of the bundle in the place of its own. Without single sign-on, of which the bundle has no image."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import yaml

from ci import toolchain
from ci.bundle import ARGO_CD
from gitops.argocd.render import IMAGES
from tests.stages.platform.lent_cluster import LentCluster

NAMESPACE = "argocd"
WORKLOADS = ("Deployment", "StatefulSet")
APPLY_SECONDS_MAX, START_SECONDS_MAX = 120, 240
MADE_BY_IT = ("secret/argocd-initial-admin-secret", "appproject/default")  # moments after it starts


def install(cluster: LentCluster, bundled: Mapping[str, str]) -> None:
    """Install it, and wait until it runs and has made what it makes by itself; `bundled`: digests of images by name."""
    objects = list(_objects(cluster.place, bundled))
    cluster.ask("create", "namespace", NAMESPACE)
    words = ("-n", NAMESPACE, "apply", "--server-side", "-f", "-")
    cluster.ask(*words, text=yaml.safe_dump_all(objects), seconds=APPLY_SECONDS_MAX)
    bound = f"--timeout={START_SECONDS_MAX}s"
    for name in (f"{one['kind']}/{one['metadata']['name']}" for one in objects if one["kind"] in WORKLOADS):
        cluster.ask("-n", NAMESPACE, "rollout", "status", name, bound, seconds=START_SECONDS_MAX + 10)
    for name in MADE_BY_IT:
        cluster.ask("-n", NAMESPACE, "wait", "--for=create", name, bound, seconds=START_SECONDS_MAX + 10)


def _objects(place: str, bundled: Mapping[str, str]) -> Iterator[dict[str, Any]]:
    """Those of its install.yaml, whose images keep their tags and are pulled from HOST/PATH."""
    text = (toolchain.module_dir(ARGO_CD) / "manifests" / "install.yaml").read_text(encoding="utf-8")
    for document in filter(None, yaml.load_all(text, Loader=yaml.CSafeLoader)):
        if document["kind"] in WORKLOADS:
            pod = document["spec"]["template"]["spec"]
            containers = [*pod.get("initContainers", ()), *pod["containers"]]
            if not all(_repository(container) in IMAGES for container in containers):
                continue
            for one in containers:
                name, tag = IMAGES[_repository(one)], one["image"].rpartition(":")[2]
                one["image"] = f"{place}/{name}:{tag}@{bundled[name]}"
        yield document


def _repository(container: Mapping[str, Any]) -> str:
    return str(container["image"]).rpartition(":")[0]
