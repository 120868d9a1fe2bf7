"""A cluster by kind, with Debian's Docker in namespaces of its own and the image of nodes that is made here: it is one
on which pods find each other and keep what they write, and the paper's use case, small, runs there. Nothing is left.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator

import pytest

from ci import kind_cli
from ci.cluster.kind.configuration import CLUSTER, WORKERS, configuration
from ci.cluster.kind.provider import KindCluster
from ci.cluster_contract import topology
from ci.cluster_contract.topology import Topology
from ci.folders import PROJECT
from ci.kind_node_image import naming
from ci.kind_node_image.component_images import NETWORK
from ci.machine import cgroups, preparing
from scenarios import definition
from tests.stages.kind.docker_engine import DockerEngine
from tests.stages.kind.node_engine import node_engine, require_nothing_runs
from tests.stages.platform.running_platform import SCENARIO, VARIANT, spoken

pytestmark = pytest.mark.thorough

REPORT = PROJECT / "build" / "reports" / SCENARIO.name / "report.json"
CREATE_SECONDS_MAX, DEMO_SECONDS_MAX, DOWN_SECONDS_MAX = 400, 1500, 300
SERVICE = "https://kubernetes.default.svc.cluster.local"
# It finds the API server by its Service's name, and keeps a word on a volume of the class that kind has.
JOB = rf"""
apiVersion: v1
kind: PersistentVolumeClaim
metadata: {{name: kept}}
spec: {{accessModes: [ReadWriteOnce], resources: {{requests: {{storage: 1Mi}}}}}}
---
apiVersion: batch/v1
kind: Job
metadata: {{name: proof}}
spec:
  backoffLimit: 2
  template:
    spec:
      restartPolicy: Never
      containers:
        - name: proof
          image: {NETWORK}
          imagePullPolicy: Never
          command:
            - sh
            - -euc
            - |
              account=/var/run/secrets/kubernetes.io/serviceaccount
              kubectl --server {SERVICE} --certificate-authority $account/ca.crt --token "$(cat $account/token)" \
                get --raw /version
              echo word >/kept/file
              cat /kept/file
          resources: {{requests: {{cpu: 20m, memory: 32Mi}}, limits: {{cpu: 20m, memory: 32Mi}}}}
          volumeMounts: [{{name: kept, mountPath: /kept}}]
      volumes: [{{name: kept, persistentVolumeClaim: {{claimName: kept}}}}]
"""


@pytest.fixture(scope="module")
def engine(pytestconfig: pytest.Config) -> Iterator[DockerEngine]:
    with node_engine(pytestconfig) as started:
        yield started


def test_the_image_that_is_made_here_boots_a_cluster(engine: DockerEngine) -> None:
    kind, kubectl = str(kind_cli.ensure()), str(preparing.tool_chain() / "kubectl")
    kubeconfig = f"--kubeconfig={engine.folder / 'kubeconfig'}"
    nodes = Topology(topology.read(SCENARIO / "scenario.yaml", {"vehicles": "1"}).nodes[:2])
    configured = configuration(nodes, cgroups_of_version_1=not cgroups.unified())
    words = ["create", "cluster", "--config=-", kubeconfig, "--wait=120s", f"--image={naming.reference()}"]
    engine.run(kind, *words, seconds=CREATE_SECONDS_MAX, text=configured)
    versions = engine.run(kubectl, kubeconfig, "version", seconds=60)
    assert f"Server Version: {naming.kubernetes_version()}" in versions
    engine.run(kubectl, kubeconfig, "apply", "--filename=-", seconds=60, text=JOB)
    engine.run(kubectl, kubeconfig, "wait", "--for=condition=complete", "job/proof", "--timeout=150s", seconds=180)
    said = engine.run(kubectl, kubeconfig, "logs", "job/proof", seconds=60)
    assert f'"gitVersion": "{naming.kubernetes_version()}"' in said
    assert said.endswith("word\n")
    engine.run(kind, "delete", "cluster", f"--name={CLUSTER}", kubeconfig, seconds=DOWN_SECONDS_MAX)


@pytest.mark.parametrize("workers", [None, 2], ids=["each alone", "two workers"])
def test_the_use_case_runs_there_and_nothing_stays(
    engine: DockerEngine, pytestconfig: pytest.Config, workers: int | None
) -> None:
    """On a worker for each node of the scenario, and in trial mode: platform and cloud on one, vehicles on another."""
    with spoken(pytestconfig):
        print("\nthe use case on a cluster by kind, six minutes", file=sys.stderr, flush=True)
    words = ["CLUSTER=kind", f"VARIANT={VARIANT}", "KEEP_DRIVING=0"]
    words += [f"{WORKERS}={workers}"] if workers else []
    REPORT.unlink(missing_ok=True)
    said = engine.attempt("make", "demo", *words, seconds=DEMO_SECONDS_MAX)
    assert REPORT.exists(), said.stdout[-2000:] + said.stderr[-4000:]
    report = json.loads(REPORT.read_text(encoding="utf-8"))
    failed = [row for row in report["expectations"] if not row["passed"]]
    assert (said.returncode, failed) == (0, []), said.stdout[-4000:] + said.stderr[-4000:]
    assert {row["name"] for row in report["expectations"]} >= set(definition.load(SCENARIO, [], VARIANT).expectations)
    for text in KindCluster.LACKS:
        assert f"a cluster of kind kind: {text}" in report["warnings"]
    assert any("trial mode: agents share Nodes" in text for text in report["warnings"]) == bool(workers)
    assert f"of {naming.reference()}" in said.stderr
    removed = engine.run("make", "down", "CLUSTER=kind", seconds=DOWN_SECONDS_MAX)
    assert f"kind cluster {CLUSTER} with its containers and volumes" in removed
    require_nothing_runs(engine)
