"""Releases that reach main past manager and gate: charts that nobody verified, and what becomes of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from robotkube.delivery.deployment.core.releases import Release, Source, write_release, write_source
from robotkube.registry.charts.adapters.chart_folders import pack
from robotkube.registry.charts.adapters.oci import OciRegistry
from tests.stages.platform.running_platform import Platform, Writer

AGENT, PLAN = "vehicle-02", "20261121-100000-abcdef"
CHARTS = "oci://forge.robotkube.svc.cluster.local:3000/verified"
REFUSED_SECONDS_MAX = 90.0
VERSION = "0.2.3"
NAMES = ("everything", "foreign", "unknown")
CONFIGMAP = """
apiVersion: v1
kind: ConfigMap
metadata: {name: {{ .Release.Name }}}
data: {reached: the cluster}
"""
CLUSTER_ROLE = """
apiVersion: rbac.authorization.k8s.io/v1
kind: ClusterRole
metadata: {name: everything-test}
rules: [{apiGroups: ["*"], resources: ["*"], verbs: ["*"]}]
"""
UNKNOWN_DIGEST = "sha256:" + "d" * 64


def push_chart(platform: Platform, folder: Path, name: str, organisation: str) -> str:
    """A chart with a ConfigMap and a ClusterRole that no gate has seen; returns its digest."""
    (folder / "templates").mkdir(parents=True)
    (folder / "Chart.yaml").write_text(f"apiVersion: v2\nname: {name}\nversion: {VERSION}\n")
    (folder / "values.yaml").write_text("{}\n")
    (folder / "templates" / "configmap.yaml").write_text(CONFIGMAP)
    (folder / "templates" / "clusterrole.yaml").write_text(CLUSTER_ROLE)
    with OciRegistry(platform.forge_url(), "gate", platform.password("gate")) as registry:
        return registry.push_chart(organisation, pack(folder, {}))


def files(name: str, chart: str, digest: str, annotation: str = "") -> dict[str, str | None]:
    """A release with its source; `annotation` stands where the chart's name should."""
    release = Release(AGENT, name, chart, VERSION, digest, {}, plan=PLAN)
    text = write_release(release)
    if annotation:
        text = text.replace(f"robotkube.io/chart: {chart}\n", f"robotkube.io/chart: {annotation}\n")
        assert annotation in text
    source = Source(AGENT, chart, digest, f"{CHARTS}/{chart}")
    return {release.path: text, source.path: write_source(source)}


def bring_to_main(platform: Platform, folder: Path) -> Writer:
    """The releases of NAMES on main, by the one account that may push there: a published place without a publication, a
    way out of that place, and a digest that nobody has."""
    digest = push_chart(platform, folder / "everything", "everything", "verified")
    staged = push_chart(platform, folder / "staged", "staged", "staging")
    gate = platform.writer("gate", folder / "gate")
    changes = files("everything", "everything", digest)
    changes |= files("foreign", "elsewhere", staged, annotation="../staging/staged")
    changes |= files("unknown", "mqtt-bridge", UNKNOWN_DIGEST)
    gate.push(changes, "test: releases that no gate has seen\n")
    return gate


def application(platform: Platform, name: str) -> dict[str, Any]:
    """The Application of one of these releases, empty when there is none."""
    return dict(platform.access.applications().get(f"{AGENT}-{name}", {}))


def conditions(found: Mapping[str, Any]) -> str:
    """All that Argo CD says against an Application."""
    status = found.get("status", {})
    texts = [f"{entry['type']}: {entry['message']}" for entry in status.get("conditions", [])]
    return "\n".join([*texts, status.get("operationState", {}).get("message", "")])


def reached_nothing(platform: Platform) -> bool:
    """Return whether nothing of these releases is in the cluster."""
    texts = [platform.kubectl("-n", AGENT, "get", "configmap", name, "--ignore-not-found") for name in NAMES]
    return not any(texts) and platform.kubectl("get", "clusterrole", "everything-test", "--ignore-not-found") == ""
