"""Which volume a waiting claim gets when the platform is installed, and where the console is then."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ci.cluster_contract.provider import ChartProfile
from ci.installation import Installer, chosen_volumes, stated_values
from scenarios import demo


def claim(name: str, agent: str, phase: str = "Pending") -> dict[str, Any]:
    labels = {"robotkube.io/agent": agent}
    return {"metadata": {"namespace": agent, "name": name, "labels": labels}, "status": {"phase": phase}}


def volume(name: str, agent: str, node: str = "", phase: str = "Available", **spec: Any) -> dict[str, Any]:
    affinity = {"required": {"nodeSelectorTerms": [{"values": [node or agent]}]}}
    labels = {"robotkube.io/agent": agent}
    return {
        "metadata": {"name": name, "labels": labels},
        "spec": {"nodeAffinity": affinity, **spec},
        "status": {"phase": phase},
    }


def chosen(claims: list[dict[str, Any]], volumes: list[dict[str, Any]]) -> dict[str, str]:
    bound = chosen_volumes(claims, volumes)
    return {
        one["metadata"]["name"]: f"{one['spec']['claimRef']['namespace']}/{one['spec']['claimRef']['name']}"
        for one in bound
    }


def test_each_claim_gets_a_free_volume_of_its_agent() -> None:
    volumes = [volume("a-0", "a", phase="Bound"), volume("a-1", "a", claimRef={"name": "x"}), volume("a-2", "a")]
    volumes += [volume("a-3", "a"), volume("b-0", "b")]
    claims = [claim("recordings", "a"), claim("bags", "a"), claim("bags", "b")]
    assert chosen(claims, volumes) == {"a-2": "a/recordings", "a-3": "a/bags", "b-0": "b/bags"}


def test_what_is_bound_or_could_run_on_several_nodes_is_left_to_the_scheduler() -> None:
    volumes = [volume("a-0", "a", "one"), volume("a-1", "a", "two"), volume("b-0", "b"), volume("c-0", "c")]
    claims = [claim("recordings", "a"), claim("bags", "b", "Bound"), claim("bags", "c"), claim("more", "c")]
    assert chosen(claims, volumes) == {"c-0": "c/bags"}
    assert chosen_volumes([], volumes) == []


def test_argo_cd_hears_of_the_network_what_the_chart_hears() -> None:
    """Files of the profile first, then its values."""
    own = {"networkPolicies": {"apiServer": {"to": [{"ipBlock": {"cidr": "192.0.2.10/32"}}]}}}
    stated = stated_values(ChartProfile(("values-embedded.yaml",), own))["networkPolicies"]
    assert stated["apiServer"] == {"to": own["networkPolicies"]["apiServer"]["to"], "ports": [6443]}
    assert stated["dns"]["to"][0] == {"ipBlock": {"cidr": "10.89.0.1/32"}}
    assert stated_values(ChartProfile(values={"storage": {}})) == {"storage": {}}


class Installed(Installer):
    """An installer of a cluster whose console's Service has this address."""

    address = ""

    def kubectl(self, *arguments: str, text: str | None = None, seconds: int = 60) -> str:
        assert arguments[:5] == ("-n", "robotkube", "get", "service", "console")
        return self.address


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("10.96.0.7:8080", "The console shows the fleet: http://10.96.0.7:8080/"),
        ("", "No console; `ci/python -m robotkube.cli watch` shows the fleet."),
    ],
)
def test_a_demo_ends_with_where_the_fleet_is_seen(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], address: str, said: str
) -> None:
    monkeypatch.setattr(Installed, "address", address)
    monkeypatch.setattr(demo, "bring_up", lambda request, steps: Installed(Path(), Path("kubeconfig"), Path()))
    monkeypatch.setattr(demo.running, "run", lambda *arguments, **named: 0)
    monkeypatch.setattr(demo.Request, "settled", lambda self: SimpleNamespace(steps=(), network={}))
    assert demo.run(demo.Request(Path("scenario"), {}, demo.Choice(), "scenario")) == 0
    assert capsys.readouterr().out.splitlines()[-1] == said
