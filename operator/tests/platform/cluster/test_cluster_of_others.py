"""The paper's use case, small, on a cluster that somebody else made: taken by its kubeconfig, with every image from the
bundle in a registry, and given back as it was. Once each agent has a Node of its own, once they share two."""

from __future__ import annotations

import json
import socket
import sys
from collections.abc import Iterator
from http import HTTPStatus
from pathlib import Path

import pytest

from ci.cluster.through_api_server.forwards import Forwards
from ci.cluster_contract import topology
from ci.cluster_contract.provider import ServicePort
from ci.folders import PROJECT
from ci.images import preparation
from scenarios import definition
from tests.stages import http_calls
from tests.stages.platform import lent_cluster
from tests.stages.platform.cluster_of_others import each_alone, made
from tests.stages.platform.lent_cluster import LentCluster, two_machines
from tests.stages.platform.running_platform import NAME, SCENARIO, VARIANT, spoken

pytestmark = pytest.mark.thorough

REPORT = PROJECT / "build" / "reports" / SCENARIO.name / "report.json"
CONSOLE_PORT, HEALTH_PORT = 8080, 8081
POD_ADDRESS = "jsonpath={.items[0].status.podIP}"


@pytest.fixture(scope="module", params=[each_alone, two_machines], ids=lambda machines: machines.__name__)
def cluster(
    request: pytest.FixtureRequest, no_demo: None, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[LentCluster]:
    prepared = preparation.everything()
    scenario = definition.load(SCENARIO, [], VARIANT)
    nodes = topology.read(SCENARIO / "scenario.yaml", {"vehicles": str(len(scenario.vehicles))})
    machines = request.param(nodes)
    with made(NAME, prepared.binaries, machines, prepared.images, tmp_path_factory.mktemp("others")) as lent:
        yield lent


def _console_answers_forwards_alone(cluster: LentCluster) -> None:
    """At its pod's address, which this machine reaches here, nobody listens but for health."""
    forwards = Forwards(cluster.kubectl)
    try:
        host, port = forwards.address(ServicePort("robotkube", "console", "", CONSOLE_PORT))
        fleet = http_calls.get(f"http://{host}:{port}/api/snapshot", timeout=10).json()
    finally:
        forwards.end()
    assert {"cloud-0", "vehicle-00", "vehicle-01"} <= set(fleet["items"]["agents"])
    chosen = ("-n", "robotkube", "-l", "app.kubernetes.io/component=console")
    address = cluster.ask("get", "pods", *chosen, "-o", POD_ADDRESS)
    assert http_calls.get(f"http://{address}:{HEALTH_PORT}/metrics", timeout=10).status_code == HTTPStatus.OK
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((address, CONSOLE_PORT), timeout=10)


def test_the_use_case_runs_there_and_leaves_it_as_it_was(
    cluster: LentCluster, pytestconfig: pytest.Config, tmp_path: Path
) -> None:
    bundled = cluster.bring_bundle(tmp_path / "robotkube.tar")
    before = lent_cluster.settled_objects(cluster)
    with spoken(pytestconfig):
        print("\nthe use case on a cluster of others, three minutes", file=sys.stderr, flush=True)
    said = cluster.demo(VARIANT=VARIANT, KEEP_DRIVING="0")
    report = json.loads(REPORT.read_text(encoding="utf-8"))
    assert report["passed"], said
    _console_answers_forwards_alone(cluster)
    lent_cluster.require_digests(cluster, bundled)
    shared = any("trial mode: agents share Nodes (Node machine-0" in text for text in report["warnings"])
    assert shared == cluster.shares == ("trial mode: agents share Nodes (Node machine-0" in said)
    assert "Node machine-0" in cluster.down()
    lent_cluster.require_as_before(cluster, before)
