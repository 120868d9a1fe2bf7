"""What the host's process sees stands in a real API server, written with the administrator's certificate: first there
is no kind to write, then no namespace, then all of it."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from ci.cluster.embedded.containers.beside_kubelets import NodeContents, RuntimeContainer
from ci.cluster.embedded.containers.polling import NAMESPACE, ClusterReports, ContainerPoll, api_server
from ci.cluster.embedded.containers.reports import PROCESS
from ci.cluster.embedded.control_plane.pki import Authority, control_plane_identities
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.network.addresses import plan_of
from robotkube.delivery.inspection.adapters.kubernetes_inspections import KubernetesInspections
from robotkube.delivery.inspection.loops.reporting import Reporter
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.kubernetes.adapters.client import api_client
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer
from tests.stages.kubernetes.api_calls import Api, served
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.paths import REPOSITORY
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

DEFINITION = REPOSITORY / "charts/robotkube/templates/inspections/customresourcedefinition.yaml"
DEFINITIONS = "/apis/apiextensions.k8s.io/v1/customresourcedefinitions"
INSPECTIONS = f"/apis/robotkube.io/v1alpha1/namespaces/{NAMESPACE}/inspections"
EVENTS = f"/apis/events.k8s.io/v1/namespaces/{NAMESPACE}/events"
FOREIGN = RuntimeContainer("default", "miner", program="/bin/miner")


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ClusterFolders:
    """A cluster's certificates."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    cluster_folders = ClusterFolders("containers")
    authority = Authority(cluster_folders.pki)
    authority.create()
    for identity in control_plane_identities(plan_of("test")):
        if identity.name in ("admin", "apiserver"):
            authority.issue(identity)
    return cluster_folders


@pytest.fixture
def server(folders: ClusterFolders, tmp_path: Path) -> Iterator[ApiServerProcess]:
    """An API server with these certificates, in which nothing is installed."""
    pki = folders.pki
    options = (
        f"--client-ca-file={pki / 'ca.crt'}",
        f"--tls-cert-file={pki / 'apiserver.crt'}",
        f"--tls-private-key-file={pki / 'apiserver.key'}",
    )
    process = ApiServerProcess(tmp_path, options, signed_by=pki / "ca.crt", host="localhost")
    try:
        process.start()
        yield process
    finally:
        process.stop()


@pytest.fixture
def api(server: ApiServerProcess) -> Iterator[Api]:
    made = Api(api_client(str(server.kubeconfig)))
    yield made
    made.client.rest_client.pool_manager.clear()


@pytest.fixture
def own(folders: ClusterFolders, server: ApiServerProcess) -> Iterator[ApiServer]:
    """The host's connection."""
    made = api_server(f"https://localhost:{server.port}", folders)
    yield made
    made.close()


class OneNode:
    """A node in memory."""

    def __init__(self) -> None:
        self.node = NodeContents((FOREIGN,))

    def names(self) -> tuple[str, ...]:
        return ("vehicle-00",)

    def read(self, name: str) -> NodeContents:
        assert name == "vehicle-00"
        return self.node


def install_definition(api: Api) -> None:
    text = "".join(line for line in DEFINITION.read_text().splitlines(True) if "{{" not in line)
    api.post(DEFINITIONS, yaml.safe_load(text))
    until(lambda: served(api, INSPECTIONS), "the kind is served")


def test_a_stranger_is_written_as_soon_as_the_platform_is_there(api: Api, own: ApiServer) -> None:
    reporter = Reporter(KubernetesInspections(own, NAMESPACE, PROCESS, time.time), time.time_ns)
    node = OneNode()
    now = 0.0
    poll = ContainerPoll(node, lambda: now)

    def reported() -> str:
        return ClusterReports(reporter.report, lambda: now)(poll.looks())

    assert "takes no Inspections; they are written once the platform is installed" in reported()
    install_definition(api)
    assert f'namespaces "{NAMESPACE}" not found' in reported()
    api.post("/api/v1/namespaces", {"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": NAMESPACE}})
    assert reported() == ""

    written = api.get(f"{INSPECTIONS}/machine.vehicle-00")
    assert written["spec"] == {"looksAt": "machine", "node": "vehicle-00"}
    [stranger] = written["status"]["strangers"]
    assert (stranger["kind"], stranger["name"], stranger["reason"]) == ("Container", FOREIGN.key, "BesideTheKubelet")
    assert "on node vehicle-00 runs /bin/miner" in stranger["message"]
    assert {one["type"]: one["status"] for one in written["status"]["conditions"]} == {"Seen": "True", "Clean": "False"}

    node.node = NodeContents()
    assert reported() == ""
    assert api.get(f"{INSPECTIONS}/machine.vehicle-00")["status"]["strangersTotal"] == 0
    events = api.get(EVENTS)["items"]
    assert sorted((event["reason"], event["type"]) for event in events) == [
        ("BesideTheKubelet", "Warning"),
        ("StrangerGone", "Normal"),
    ]
    assert {event["reportingController"] for event in events} == {"robotkube.io/containers"}
    assert json.dumps(events).count("machine.vehicle-00") >= len(events)


POLICIES = "/apis/admissionregistration.k8s.io/v1/mutatingadmissionpolicies"
BINDINGS = "/apis/admissionregistration.k8s.io/v1/mutatingadmissionpolicybindings"
RULE = {"apiGroups": ["robotkube.io"], "apiVersions": ["*"], "resources": ["inspections/status"], "operations": ["*"]}
EMPTIED = {
    "metadata": {"name": "nothing-is-strange"},
    "spec": {
        "failurePolicy": "Fail",
        "reinvocationPolicy": "Never",
        "matchConstraints": {"resourceRules": [RULE]},
        "mutations": [
            {
                "patchType": "JSONPatch",
                "jsonPatch": {"expression": '[JSONPatch{op: "replace", path: "/status/strangers", value: []}]'},
            }
        ],
    },
}


def test_what_others_make_of_an_inspection_is_seen(api: Api, own: ApiServer) -> None:
    """A patch is written over; a policy that empties what is written is said by the answer to the write."""
    install_definition(api)
    api.post("/api/v1/namespaces", {"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": NAMESPACE}})
    reporter = Reporter(KubernetesInspections(own, NAMESPACE, PROCESS, time.time), time.time_ns)
    poll = ContainerPoll(OneNode(), lambda: 0.0)
    [look] = poll.looks()
    reporter.report(look)
    reporter.attend()
    path = f"{INSPECTIONS}/machine.vehicle-00"
    before = api.get(path)
    own.patch(f"{path}/status", {"status": {"strangers": [], "strangersTotal": 0}})
    assert api.get(path)["status"]["strangers"] == []
    reporter.attend()
    assert api.get(path)["status"] == before["status"]

    api.post(POLICIES, EMPTIED)
    api.post(BINDINGS, {"metadata": {"name": "x"}, "spec": {"policyName": EMPTIED["metadata"]["name"]}})

    def emptied() -> str:
        own.delete(path)
        try:
            reporter.attend()
            reporter.report(look)  # attending leaves what could not be written to the next look
        except InputError as error:
            return str(error)
        except UnavailableError:  # where mutations are computed, a new definition is known a few seconds later
            pass
        return ""

    until(lambda: "the API server has something else than what was written" in emptied(), "the policy works")
    with pytest.raises(InputError, match="something else"):
        reporter.report(look)
