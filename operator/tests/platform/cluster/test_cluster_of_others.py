"""The paper's use case, small, on a cluster that somebody else made: taken by its kubeconfig, with every image from the
bundle in a registry, and given back as it was. Once each agent has a Node of its own, once they share two."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from http import HTTPStatus
from pathlib import Path
from typing import Any

import pytest
import yaml

from ci import bundle, evidence, oras, publish
from ci.cluster.through_api_server.forwards import Forwards
from ci.cluster_contract import topology
from ci.cluster_contract.provider import ServicePort
from ci.folders import PROJECT
from ci.images import preparation
from ci.images.services import SERVICE_NAMES
from robotkube.cli.main import main
from robotkube.registry.publication.adapters import submission_folders
from scenarios import definition
from tests.stages import http_calls
from tests.stages.platform.cluster_of_others import ClusterOfOthers, each_alone, made, two_machines
from tests.stages.platform.running_platform import NAME, SCENARIO, VARIANT, spoken

pytestmark = pytest.mark.thorough

REPORT = PROJECT / "build" / "reports" / SCENARIO.name / "report.json"
CONSOLE_PORT, HEALTH_PORT = 8080, 8081
FORGE = "forge.robotkube.svc.cluster.local:3000/robotkube"
POD_ADDRESS = "jsonpath={.items[0].status.podIP}"
DEMO_SECONDS_MAX, DOWN_SECONDS_MAX = 1200, 300
PASSING = {
    "leases.coordination.k8s.io",
    "events",
    "events.events.k8s.io",
    "endpoints",
    "endpointslices.discovery.k8s.io",
}
RETAINED = "persistentvolumes "  # their class retains them, with whose they were


@pytest.fixture(scope="module", params=[each_alone, two_machines], ids=lambda machines: machines.__name__)
def cluster(
    request: pytest.FixtureRequest, no_demo: None, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[ClusterOfOthers]:
    prepared = preparation.everything()
    scenario = definition.load(SCENARIO, [], VARIANT)
    nodes = topology.read(SCENARIO / "scenario.yaml", {"vehicles": str(len(scenario.vehicles))})
    machines = request.param(nodes)
    with made(NAME, prepared.binaries, machines, prepared.images, tmp_path_factory.mktemp("others")) as made_cluster:
        _push(made_cluster, tmp_path_factory.mktemp("bundle") / "robotkube.tar")
        yield made_cluster


def _push(cluster: ClusterOfOthers, path: Path) -> None:
    prepared = preparation.everything()
    charts = submission_folders.all_charts(publish.CHARTS)
    submitted = publish.read_all(prepared.references(), evidence.kept_folder(), charts)
    bundle.write(path, prepared.images, submitted, bundle.argocd_manifests(prepared.references()))
    words = ["--to", cluster.place, "--ca", str(cluster.authority), "--oras", str(oras.ensure() / "oras")]
    assert main(["bundle", "push", str(path), *words]) == 0
    path.unlink()


def _make(cluster: ClusterOfOthers, target: str, seconds: int, **variables: str) -> str:
    """What `make` prints about this cluster; fails with it."""
    reached = {"CLUSTER": "existing", "KUBECONFIG": str(cluster.provider.kubeconfig()), "YES": "1"}
    words = [f"{name}={value}" for name, value in {**reached, **variables}.items()]
    done = subprocess.run(
        ["make", target, *words], cwd=PROJECT, env=os.environ, capture_output=True, text=True, timeout=seconds
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    return done.stdout


def _objects(cluster: ClusterOfOthers) -> dict[str, Any]:
    """Every object by kind, namespace and name, without what counts its versions and what comes and goes, and of
    PersistentVolumes only that they are there."""
    kubectl = [str(cluster.provider.binaries / "kubectl"), "--kubeconfig", str(cluster.provider.kubeconfig())]

    def asked(*words: str) -> str:
        return subprocess.run([*kubectl, *words], capture_output=True, text=True, timeout=60, check=True).stdout

    kinds = [kind for kind in asked("api-resources", "--verbs=list", "-o", "name").split() if kind not in PASSING]
    objects = {}
    for kind in kinds:
        for item in json.loads(asked("get", kind, "-A", "-o", "json"))["items"]:
            metadata = item["metadata"]
            kept = {key: metadata.get(key) for key in ("labels", "annotations", "finalizers")}
            objects[f"{kind} {metadata.get('namespace', '')}/{metadata['name']}"] = [kept, item.get("spec")]
    return {name: "kept" if name.startswith(RETAINED) else item for name, item in objects.items()}


def _what_runs_has_the_digests_of_the_bundle(cluster: ClusterOfOthers) -> None:
    """As each runtime says what its containers' images are: the platform's by the names of the registry, those of
    applications by that of the forge, to which a publication brings what it verified."""
    kubectl = [str(cluster.provider.binaries / "kubectl"), "--kubeconfig", str(cluster.provider.kubeconfig())]
    asked = subprocess.run([*kubectl, "get", "pods", "-A", "-o", "json"], capture_output=True, timeout=60, check=True)
    statuses = [pod["status"] for pod in json.loads(asked.stdout)["items"]]
    kinds = ("containerStatuses", "initContainerStatuses")
    runs = {one["imageID"] for status in statuses for kind in kinds for one in status.get(kind, ()) if one["imageID"]}
    bundled = {image.name: image.reference.partition("@")[2] for image in preparation.everything().images}
    names = {place.partition("@")[0].rpartition("/")[2] for place in runs}
    assert names >= {"platform", "mosquitto", "gitea", "ferretdb", "argocd", "mqtt-bridge", "event-detector"}, runs
    by_forge = {name for name in names if name in SERVICE_NAMES}
    places = {name: FORGE if name in by_forge else cluster.place for name in names}
    assert by_forge
    assert runs == {f"{places[name]}/{name}@{bundled[name]}" for name in names}


def _console_answers_forwards_alone(cluster: ClusterOfOthers) -> None:
    """At its pod's address, which this machine reaches here, nobody listens but for health."""
    kubectl = [str(cluster.provider.binaries / "kubectl"), "--kubeconfig", str(cluster.provider.kubeconfig())]
    forwards = Forwards(kubectl)
    try:
        host, port = forwards.address(ServicePort("robotkube", "console", "", CONSOLE_PORT))
        fleet = http_calls.get(f"http://{host}:{port}/api/snapshot", timeout=10).json()
    finally:
        forwards.end()
    assert {"cloud-0", "vehicle-00", "vehicle-01"} <= set(fleet["items"]["agents"])
    asked = ("get", "pods", "-n", "robotkube", "-l", "app.kubernetes.io/component=console", "-o", POD_ADDRESS)
    address = subprocess.run([*kubectl, *asked], capture_output=True, text=True, timeout=60, check=True).stdout
    assert http_calls.get(f"http://{address}:{HEALTH_PORT}/metrics", timeout=10).status_code == HTTPStatus.OK
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((address, CONSOLE_PORT), timeout=10)


def test_the_use_case_runs_there_and_leaves_it_as_it_was(cluster: ClusterOfOthers, pytestconfig: pytest.Config) -> None:
    before = _objects(cluster)
    with spoken(pytestconfig):
        print("\nthe use case on a cluster of others, three minutes", file=sys.stderr, flush=True)
    said = _make(
        cluster,
        "demo",
        DEMO_SECONDS_MAX,
        REGISTRY=cluster.place,
        REGISTRY_CA=str(cluster.authority),
        AGENTS=str(cluster.agents),
        VARIANT=VARIANT,
        KEEP_DRIVING="0",
    )
    report = json.loads(REPORT.read_text(encoding="utf-8"))
    assert report["passed"], said[-4000:]
    _console_answers_forwards_alone(cluster)
    _what_runs_has_the_digests_of_the_bundle(cluster)
    shares = yaml.safe_load(cluster.agents.read_text(encoding="utf-8")).get("trial", False)
    assert any("trial mode: agents share Nodes (Node machine-0" in text for text in report["warnings"]) == shares
    assert ("trial mode: agents share Nodes (Node machine-0" in said) == shares
    removed = _make(cluster, "down", DOWN_SECONDS_MAX)
    assert "Node machine-0" in removed
    after = _objects(cluster)
    assert {name: after.get(name) for name in before | after if before.get(name) != after.get(name)} == {}
