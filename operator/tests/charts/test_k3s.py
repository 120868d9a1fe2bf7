"""The platform's chart as the provider `k3s` has it installed: what its values change, and that k3s's own parts which
give out addresses have nothing to do."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ci.cluster.existing.mapping import AgentEntry
from ci.cluster.k3s.nodes import K3sNode
from ci.cluster.k3s.values import chart_values
from ci.cluster.through_api_server.ways import values_of_built_images
from ci.cluster_contract.topology import chart_agents
from tests.stages.paths import CHARTS

pytestmark = pytest.mark.toolchain

PLATFORM = CHARTS / "robotkube"
IMAGES = Path(__file__).parent / "profiles" / "embedded.yaml"
VERSION = "v1.34.1+k3s1"
NODES = [
    K3sNode("server", "192.0.2.10", VERSION, "boot", ("10.42.0.0/24",)),
    K3sNode("edge", "192.0.2.11", VERSION, "other", ("10.42.1.0/24",)),
    K3sNode("robot", "192.0.2.12", VERSION, "third", ("10.42.2.0/24",)),
]
ENTRIES = [
    AgentEntry("server", (), "platform", "platform"),
    AgentEntry("edge", (), "cloud", "cloud-0", ("recording",)),
    AgentEntry("robot", (), "vehicle", "vehicle-00", ("lidar",)),
]
OTHERS = {"agents": chart_agents(ENTRIES), **values_of_built_images()}


@pytest.fixture(scope="module")
def k3s(helm: Any) -> Any:
    own = chart_values(NODES, {("192.0.2.10", 6443)}, {"local-path"})
    return helm.template(PLATFORM, IMAGES, **OTHERS, **own)


def test_what_the_values_of_k3s_change_is_as_committed(helm: Any, k3s: Any, golden: Callable[[str, str], None]) -> None:
    without = set(helm.template(PLATFORM, IMAGES, **OTHERS).text.split("---\n"))
    changed = [part for part in k3s.text.split("---\n") if part not in without]
    assert changed
    golden("k3s", "---\n".join(["", *changed]))


def test_every_volume_is_of_the_class_that_k3s_brings(k3s: Any) -> None:
    claims = [one["spec"] for one in k3s.of_kind("PersistentVolumeClaim")]
    claims += [
        spec["spec"] for one in k3s.of_kind("StatefulSet") for spec in one["spec"].get("volumeClaimTemplates", [])
    ]
    assert len(claims) >= 5
    assert {claim["storageClassName"] for claim in claims} == {"local-path"}


def test_its_load_balancer_and_its_ingress_controller_have_nothing_to_do(k3s: Any, argocd: list[Any]) -> None:
    services = [*k3s.of_kind("Service"), *(one for one in argocd if one["kind"] == "Service")]
    assert {service["metadata"]["name"] for service in services} >= {"forge", "broker", "argocd-server"}
    assert {service["spec"].get("type", "ClusterIP") for service in services} == {"ClusterIP"}
    kinds = {one["kind"] for one in (*k3s.objects, *argocd)}
    assert not kinds & {"Ingress", "IngressRoute", "IngressRouteTCP", "Gateway", "HTTPRoute"}


def test_kubelets_have_to_show_a_certificate_of_the_cluster(k3s: Any) -> None:
    """Those of k3s do: its authority for servers signs them, for the Node's name and addresses."""
    assert "kubelets: {verify: true}" in k3s.one("ConfigMap", "inspector")["data"]["config.yaml"]


@pytest.mark.parametrize(("version", "taken"), [(VERSION, True), ("v1.29.0+k3s1", True), ("v1.28.9+k3s1", False)])
def test_a_version_with_the_mark_of_k3s_is_compared_by_its_numbers(helm: Any, version: str, taken: bool) -> None:
    done = helm.run("template", "robotkube", str(PLATFORM), "-f", str(IMAGES), "--kube-version", version)
    assert (done.returncode == 0) == taken, done.stderr
    assert taken or "kubeVersion: >=1.29.0-0 which is incompatible with Kubernetes v1.28.9" in done.stderr
