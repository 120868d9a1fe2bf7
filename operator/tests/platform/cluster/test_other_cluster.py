"""The platform where nothing is prepared for it: the chart makes the gate's key by a Job, and its process writes the
admission policies. On a cluster `test` of its own, without the provider's admission."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ci.cluster.choosing import Choice
from ci.cluster.embedded.admission import admission_files
from ci.cluster.embedded.provider import Embedded
from ci.errors import SetUpError
from ci.steps import Steps
from robotkube.registry.admission.core.policies import API_POLICIES, LIST
from scenarios import definition, demo
from scenarios.runner.platform.access import Access
from tests.stages.platform.running_platform import NAME, SCENARIO, STEPS, VARIANT, Platform, eventually, spoken

pytestmark = pytest.mark.thorough

GATE, KEY = "robotkube-gate", "gate-key"
VALUES = {"evidence": {"existingSecret": "", "trustedKeys": {}}, "admission": {"enabled": True}}
AGENT, RELEASE = "vehicle-02", "mqtt-bridge"
BACK_SECONDS_MAX = 30.0
POLICY = "validatingadmissionpolicy"


@pytest.fixture(scope="module")
def platform(
    pytestconfig: pytest.Config, no_demo: None, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Platform]:
    """Installed, and everything published with evidence by the key that the Job made."""
    scenario = definition.load(SCENARIO, [], VARIANT)
    settings = {"vehicles": str(len(scenario.vehicles))}
    Embedded(NAME, Path()).down()
    kept = tmp_path_factory.mktemp("evidence")  # another key's would be refused
    with pytest.MonkeyPatch.context() as patch, spoken(pytestconfig):
        patch.setenv(admission_files.VARIABLE, admission_files.OFF)
        request = demo.Request(SCENARIO, settings, Choice(NAME), "platform", kept, values=VALUES)
        installer = demo.bring_up(request, Steps(STEPS))
        installed = Platform(installer, Embedded(NAME, installer.binaries), Access(installer.kubeconfig), scenario)
    yield installed
    installed.access.disconnect()
    if os.environ.get("ROBOTKUBE_KEEP_CLUSTER") != "1":
        installed.provider.down()


def foreign_pod() -> str:
    """A pod as restricted as all others, of an image that nobody verified."""
    restricted = {
        "allowPrivilegeEscalation": False,
        "capabilities": {"drop": ["ALL"]},
        "runAsNonRoot": True,
        "runAsUser": 1000,
        "seccompProfile": {"type": "RuntimeDefault"},
    }
    container = {"name": "main", "image": "registry.example/miner:1", "securityContext": restricted}
    metadata = {"name": "miner", "namespace": AGENT}
    return json.dumps({"apiVersion": "v1", "kind": "Pod", "metadata": metadata, "spec": {"containers": [container]}})


def test_the_key_that_the_job_made_signs_what_runs(platform: Platform) -> None:
    eventually("all releases run", platform.settled)
    logs = platform.kubectl("-n", "robotkube", "logs", "-l", "app.kubernetes.io/name=gate-key", "--tail=-1")
    assert '"origin": "made"' in logs
    made = platform.get("-n", GATE, "configmap", "gate-public-key")["data"]
    assert len(made) == 1
    assert platform.get("-n", "robotkube", "configmap", "gate-public-key")["data"] == made
    assert platform.kubectl("-n", GATE, "get", "secret", KEY, "-o", "name").strip() == f"secret/{KEY}"


def test_pods_of_unverified_images_are_refused(platform: Platform) -> None:
    eventually("all releases run", platform.settled)
    refusal = refusal_of_a_foreign_pod(platform)
    assert "ValidatingAdmissionPolicy 'robotkube-agents'" in refusal
    assert "only images of chart versions that are verified" in refusal


@pytest.mark.parametrize("kind", [POLICY, f"{POLICY}binding", "configmap"])
def test_what_somebody_deletes_is_there_again(platform: Platform, kind: str) -> None:
    """An administrator can; while it is away, it refuses nothing."""
    names = written(platform, kind)
    assert names
    place = ("-n", "robotkube") if kind == "configmap" else ()
    before = {name: platform.get(*place, kind, name)["metadata"]["uid"] for name in names}
    platform.kubectl(*place, "delete", kind, *names)

    def back() -> bool:
        return all(platform.get(*place, kind, name)["metadata"]["uid"] != before[name] for name in names)

    eventually("all of them are there again", back, BACK_SECONDS_MAX)
    eventually("foreign pods are refused again", lambda: bool(refusal_of_a_foreign_pod(platform)), BACK_SECONDS_MAX)


def refusal_of_a_foreign_pod(platform: Platform) -> str:
    """Why admission would refuse one; empty when it would not."""
    try:
        platform.kubectl("create", "--dry-run=server", "-f", "-", text=foreign_pod())
    except SetUpError as error:
        return str(error)
    return ""


def written(platform: Platform, kind: str) -> list[str]:
    """Names of what the process writes."""
    if kind == "configmap":
        return [LIST]
    items: list[dict[str, Any]] = platform.get(kind)["items"]
    return sorted(name for name in (one["metadata"]["name"] for one in items) if name in API_POLICIES)


def test_a_release_that_was_deleted_comes_back_under_it(platform: Platform) -> None:
    platform.kubectl("-n", AGENT, "delete", "deployment", RELEASE, "--wait=false")
    eventually("Argo CD and the controllers may make it again", lambda: platform.available(AGENT, RELEASE), 120.0)
