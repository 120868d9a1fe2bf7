"""Upgrades from charts older than the commit before, and `helm rollback`, on a real API server without nodes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.stages.kubernetes.installed_chart import CHART, Cluster, prepared_cluster
from tests.stages.platform.older_charts import (
    COLUMN,
    DEFINITIONS,
    PRESENT_VALUES,
    TASKS,
    WAYS,
    older_chart,
    versions,
)
from tests.stages.settings_mounted import GATE

pytestmark = [pytest.mark.toolchain, pytest.mark.thorough]

PROFILE = Path(__file__).parent / "profiles" / "embedded.yaml"
WORKLOADS = "deployments,statefulsets"
MADE = {"broker-tls": "secret", "robotkube-ca": "configmap"}  # empty in the chart, filled by the process `certificates`
TASK = {
    "apiVersion": "robotkube.io/v1alpha1",
    "kind": "TaskDescription",
    "metadata": {"name": "t", "namespace": "cloud-0"},
    "spec": {
        "requester": "cloud-0/event-detector",
        "event": {"rule": "r", "id": "1", "time": "2026-11-21T10:00:00Z", "trace": "0" * 32},
        "application": "recording",
        "parameters": {"vehicles": ["vehicle-00"]},
    },
}


@dataclass(frozen=True)
class Turned:
    """What was seen with the older chart, after the upgrade, and after the rollback."""

    older: dict[str, Any]
    upgraded: dict[str, Any]
    back: dict[str, Any]


def look(cluster: Cluster) -> dict[str, Any]:
    """Workloads by name, the definitions and those of the chart that Helm has installed, tasks, what processes made."""

    def items(*what: str) -> list[dict[str, Any]]:
        return list(json.loads(cluster.kubectl("get", *what, "-A", "-o", "json"))["items"])

    manifest = cluster.helm("get", "manifest", "robotkube")
    return {
        "workloads": {f"{one['metadata']['namespace']}/{one['metadata']['name']}": one for one in items(WORKLOADS)},
        "definitions": versions(items("customresourcedefinitions")),
        "of the chart": versions(one for one in yaml.load_all(manifest, Loader=yaml.CSafeLoader) if one),
        "tasks": {one["metadata"]["uid"]: one["spec"] for one in items("taskdescriptions")},
        "made": [json.loads(cluster.kubectl("get", kind, name, "-o", "json"))["data"] for name, kind in MADE.items()],
    }


@pytest.fixture(scope="module", params=WAYS.values(), ids=list(WAYS))
def turned(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Turned]:
    """The platform of the older chart, upgraded and brought back, without its Jobs: nothing here runs pods."""
    chart = older_chart(tmp_path_factory.mktemp("older"), request.param.commit)
    present = tmp_path_factory.mktemp("values") / "present.yaml"
    present.write_text(yaml.safe_dump(dict(PRESENT_VALUES)))
    with prepared_cluster(tmp_path_factory.mktemp("api")) as cluster:
        labels = {"app.kubernetes.io/managed-by": "Helm"}
        owner = {"meta.helm.sh/release-name": "robotkube", "meta.helm.sh/release-namespace": "robotkube"}
        gate = {"metadata": {"name": GATE, "labels": labels, "annotations": owner}}
        cluster.kubectl("create", "-f", "-", text=yaml.safe_dump({"apiVersion": "v1", "kind": "Namespace", **gate}))
        key = ("secret", "generic", "kept-gate-key", "--from-literal=key.pem=key")
        cluster.kubectl("-n", GATE, "create", *key)
        files = ("-f", str(PROFILE), "--no-hooks")
        cluster.helm("install", "robotkube", str(chart), "-f", str(chart / "values-embedded.yaml"), *files)
        cluster.kubectl("-n", "cloud-0", "create", "-f", "-", text=yaml.safe_dump(TASK))
        for name, kind in MADE.items():
            data = {"data": {"ca.crt": "bWFkZQ=="}}
            cluster.kubectl("patch", kind, name, "--type=merge", "-p", json.dumps(data))
        older = look(cluster)
        values = ("-f", str(CHART / "values-embedded.yaml"), "-f", str(present))
        cluster.helm("upgrade", "robotkube", str(CHART), *values, *files)
        upgraded = look(cluster)
        cluster.helm("rollback", "robotkube", "--no-hooks")
        yield Turned(older, upgraded, look(cluster))


def test_definitions_are_those_of_the_chart_and_tasks_stay(turned: Turned) -> None:
    for seen, there in ((turned.older, False), (turned.upgraded, True), (turned.back, False)):
        assert set(seen["of the chart"]) == set(DEFINITIONS)
        assert seen["definitions"] == seen["of the chart"]
        assert (COLUMN in str(seen["definitions"][TASKS][0]["additionalPrinterColumns"])) is there
        assert seen["tasks"] == turned.older["tasks"]
    assert len(turned.older["tasks"]) == 1


def test_a_rollback_brings_every_workload_back_as_it_was(turned: Turned) -> None:
    def specifications(seen: dict[str, Any]) -> dict[str, Any]:
        return {name: (one["metadata"]["uid"], one["spec"]) for name, one in seen["workloads"].items()}

    assert specifications(turned.back) == specifications(turned.older)
    assert specifications(turned.upgraded) != specifications(turned.older)


def test_only_a_changed_pod_of_the_broker_is_made_anew(request: pytest.FixtureRequest, turned: Turned) -> None:
    templates = [seen["workloads"]["robotkube/broker"]["spec"]["template"] for seen in (turned.older, turned.upgraded)]
    way = WAYS[request.node.callspec.id]
    assert (templates[0] != templates[1]) is way.broker_restarts


def test_what_processes_made_is_left_alone(turned: Turned) -> None:
    assert turned.upgraded["made"] == turned.older["made"]
    assert turned.back["made"] == turned.older["made"]
