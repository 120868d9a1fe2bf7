"""The paper's use case, small, on a cluster by the program kind that somebody else made, with a registry and an Argo CD
of its own: taken by its kubeconfig alone, and given back as it was. Two workers are all agents'."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from ci.cluster_contract import topology
from ci.folders import PROJECT
from scenarios import definition
from tests.stages.kind.docker_engine import DockerEngine
from tests.stages.kind.lent_by_kind import OF_ITS_OWN, WORKERS, lent
from tests.stages.kind.node_engine import node_engine, require_nothing_runs
from tests.stages.platform import argocd_of_others, lent_cluster
from tests.stages.platform.lent_cluster import LentCluster, two_machines
from tests.stages.platform.running_platform import SCENARIO, VARIANT, spoken

pytestmark = pytest.mark.thorough

REPORT = PROJECT / "build" / "reports" / SCENARIO.name / "report.json"
SETTINGS = "jsonpath={.data.config\\.yaml}"
# kubeadm has each kubelet sign its certificate itself: the owner of such a cluster says so
VALUES = {"inspection": {"verifyKubelets": False}}


@pytest.fixture(scope="module")
def engine(pytestconfig: pytest.Config) -> Iterator[DockerEngine]:
    with node_engine(pytestconfig) as started:
        yield started


@pytest.fixture(scope="module")
def cluster(engine: DockerEngine) -> Iterator[LentCluster]:
    vehicles = len(definition.load(SCENARIO, [], VARIANT).vehicles)
    nodes = topology.read(SCENARIO / "scenario.yaml", {"vehicles": str(vehicles)})
    with lent(engine, two_machines(nodes)) as cluster_by_kind:
        yield cluster_by_kind
    require_nothing_runs(engine)


def test_the_use_case_runs_there_and_leaves_it_as_it_was(
    cluster: LentCluster, pytestconfig: pytest.Config, tmp_path: Path
) -> None:
    bundled = cluster.bring_bundle(tmp_path / "robotkube.tar")
    argocd_of_others.install(cluster, bundled)
    before = lent_cluster.settled_objects(cluster)
    with spoken(pytestconfig):
        print("\nthe use case on a cluster by kind that others made, five minutes", file=sys.stderr, flush=True)
    values = tmp_path / "values.yaml"
    values.write_text(yaml.safe_dump(VALUES), encoding="utf-8")
    REPORT.unlink(missing_ok=True)
    said = cluster.demo(VARIANT=VARIANT, KEEP_DRIVING="0", VALUES=str(values))
    report = json.loads(REPORT.read_text(encoding="utf-8"))
    assert [row for row in report["expectations"] if not row["passed"]] == [], said
    assert {row["name"] for row in report["expectations"]} >= set(definition.load(SCENARIO, [], VARIANT).expectations)
    assert any(f"trial mode: agents share Nodes (Node {WORKERS[0]}" in text for text in report["warnings"])
    lent_cluster.require_digests(cluster, bundled, OF_ITS_OWN)
    settings = yaml.safe_load(cluster.ask("-n", "robotkube", "get", "configmap", "manager", "-o", SETTINGS))
    assert settings["argocd"]["url"] == "https://argocd-server.argocd.svc.cluster.local"
    assert "refresh redirected" not in cluster.ask("-n", "robotkube", "logs", "deployment/manager")
    removed = cluster.down()
    assert all(f"Node {name}" in removed for name in WORKERS)
    assert "appproject/default of Argo CD in namespace argocd is as before" in removed
    lent_cluster.require_as_before(cluster, before)
