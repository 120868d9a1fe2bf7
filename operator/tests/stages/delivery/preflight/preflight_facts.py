"""Facts of a cluster that can take the platform's chart, so that all checks of the preflight are ok; a test changes
one."""

from __future__ import annotations

import copy
import functools
from collections.abc import Iterator
from typing import Any

import yaml

from robotkube.delivery.preflight.core.admission import KINDS
from robotkube.delivery.preflight.core.argocd import DEFINITIONS, PARTS, ArgoCd
from robotkube.delivery.preflight.core.checks import CHECKS
from robotkube.delivery.preflight.core.findings import FAILED, ClusterFinding
from robotkube.delivery.preflight.core.owners import owned_objects
from robotkube.delivery.preflight.core.registries import RegistryAnswer, hosts
from robotkube.delivery.preflight.core.releases import PresentObjects
from robotkube.delivery.preflight.core.renderings import RenderedChart, name_of
from robotkube.delivery.preflight.core.rights import Reviewed, needed_rights
from robotkube.delivery.preflight.core.storage import Storage
from robotkube.delivery.preflight.core.values import Judgement
from tests.stages.paths import CHARTS, REPOSITORY

GOLDEN = REPOSITORY / "operator/tests/charts/golden"
AGENTS = {"vehicle-00": "vehicle", "vehicle-01": "vehicle", "cloud-0": "cloud"}  # as in the golden rendering `official`
DEFAULT_CLASS = {"annotations": {"storageclass.kubernetes.io/is-default-class": "true"}, "name": "local"}
LOADER = yaml.CSafeLoader

Object = dict[str, Any]


@functools.cache
def _objects(golden: str) -> tuple[Object, ...]:
    text = (GOLDEN / f"{golden}.yaml").read_text(encoding="utf-8")
    return tuple(document for document in yaml.load_all(text, Loader=LOADER) if document)


def rendering(golden: str = "official") -> RenderedChart:
    """A golden rendering of the chart, for a test to change."""
    return RenderedChart(copy.deepcopy(list(_objects(golden))), "robotkube", "robotkube")


@functools.cache
def _untouched() -> RenderedChart:
    return RenderedChart(_objects("official"), "robotkube", "robotkube")


@functools.cache
def _reviewed() -> Reviewed:
    return Reviewed(needed_rights(_untouched()), frozenset())


def node(name: str, role: str = "vehicle", **spec: Any) -> Object:
    """A Node of the agent that has its name."""
    labels = {"robotkube.io/agent": name, "robotkube.io/role": role}
    status = {
        "conditions": [{"type": "Ready", "status": "True"}],
        "allocatable": {"cpu": "4", "memory": "8Gi"},
    }
    return {"metadata": {"name": name, "labels": labels}, "spec": spec, "status": status}


def argo_cd(**replaced: Any) -> ArgoCd:
    """Argo CD as its own manifests install it; `replaced` are whole workloads by their part, None for none."""
    workloads = {part: part_of_argo_cd(part) for part in PARTS} | replaced
    present = [workload for workload in workloads.values() if workload]
    return ArgoCd("argocd", frozenset(DEFINITIONS), present, {"server.insecure": "true"}, frozenset({80, 443}))


def part_of_argo_cd(part: str, image: str = "quay.io/argoproj/argocd:v3.5.7", ready: int = 1) -> Object:
    metadata = {"name": f"argocd-{part}", "labels": {"app.kubernetes.io/component": part}}
    keys = ({"ARGOCD_SERVER_INSECURE": "server.insecure", "ARGOCD_SERVER_ROOTPATH": "server.rootpath"}
            if part == "server" else {})  # fmt: skip
    of_map = {"name": "argocd-cmd-params-cm", "optional": True}
    env = [{"name": name, "valueFrom": {"configMapKeyRef": {**of_map, "key": key}}} for name, key in keys.items()]
    spec = {"template": {"spec": {"containers": [{"name": part, "image": image, "env": env}]}}}
    return {"metadata": metadata, "spec": spec, "status": {"readyReplicas": ready}}


def facts(**changed: Any) -> dict[str, Any]:
    """All facts, some of them changed."""
    chart = yaml.safe_load((CHARTS / "robotkube/Chart.yaml").read_text(encoding="utf-8"))
    made: RenderedChart = changed.get("rendering") or _untouched()
    agents = [{"name": name, "role": role} for name, role in AGENTS.items()]
    good = {
        "chart": chart,
        "settings": {"agents": agents, "admission": {"enabled": False}, "inspection": {"enabled": True}},
        "rendering": made,
        "judgement": Judgement((), "", "--values"),
        "version": "v1.36.3",
        "served": dict(_served(made)),
        "release": None,
        "installed": False,
        "namespace": PresentObjects((), ()),
        "namespaces": {"robotkube": {"pod-security.kubernetes.io/enforce": "restricted"}, "argocd": {}},
        "nodes": [node(name, role) for name, role in AGENTS.items()],
        "pods": [],
        "storage": Storage([{"metadata": DEFAULT_CLASS, "provisioner": "example.com/disks"}], (), ()),
        "judges": {kind: [] for kind in KINDS},
        "control_groups": dict.fromkeys(AGENTS, 2),
        "argocd": argo_cd(),
        "standing": {(str(item["kind"]), name_of(item)): None for item in owned_objects(made)},
        "rights": _reviewed(),
        "registries": {host: RegistryAnswer(200) for host in hosts(made.objects)},
    }
    return good | changed


def _served(made: RenderedChart) -> Iterator[tuple[str, frozenset[str]]]:
    """What a cluster with Argo CD serves."""
    versions = {str(item["apiVersion"]) for item in made.objects}
    for version in versions:
        yield version, frozenset(str(item["kind"]) for item in made.objects if item["apiVersion"] == version)
    yield "admissionregistration.k8s.io/v1", frozenset({"ValidatingAdmissionPolicy"})


def finding(check: str, **changed: Any) -> ClusterFinding:
    """What a check finds when these facts are changed."""
    return next(one for one in CHECKS if one.name == check).finding(facts(**changed))


def said(found: ClusterFinding) -> str:
    """Everything that a failed check says of its problems."""
    assert found.result == FAILED, found
    assert all(one.what and one.where and one.why and one.fix for one in found.problems), found
    return "\n".join(f"{one.where}: {one.what} -> {one.fix}" for one in found.problems)
