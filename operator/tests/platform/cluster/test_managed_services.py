"""The paper's use case, small, on a platform whose broker and database are others': installed by the examples of the
page about them, with the accounts that it has people make there. On a cluster `test` of its own."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest

from ci import publish
from ci.folders import PROJECT
from ci.installation import CHART, NAMESPACE
from tests.stages.platform.bare_platform import bare_platform, install
from tests.stages.platform.managed_services import ManagedServices
from tests.stages.platform.running_platform import SCENARIO, VARIANT, Platform, spoken
from tests.stages.platform.story import Story, play

pytestmark = pytest.mark.thorough

OWN = {"broker", "database", "rights", "certificates"}
COMMANDS_SECONDS_MAX = 120


@dataclass(frozen=True)
class Played:
    """The platform, as it was before anybody had an account there, and the run."""

    platform: Platform
    before: dict[str, Any]
    story: Story


@pytest.fixture(scope="module")
def played(pytestconfig: pytest.Config, no_demo: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Played]:
    """Everything is published anew there, so that its own suites have tried each chart."""
    with bare_platform(pytestconfig, VARIANT) as platform:
        with spoken(pytestconfig):
            managed = ManagedServices(platform, tmp_path_factory.mktemp("managed"))
            managed.start()
            with managed.certificate_of_forge():
                install(platform, CHART, managed.values())
            before = platform.get("-n", NAMESPACE, "pods")
            managed.make_accounts()
            publish.publish(platform.installer.kubeconfig, print, tmp_path_factory.mktemp("evidence"))
            story = play(platform, SCENARIO, VARIANT, tmp_path_factory.mktemp("story"))
        yield Played(platform, before, story)


def test_the_platform_has_neither_of_its_own(played: Played) -> None:
    kinds = "deployments,statefulsets,services,persistentvolumeclaims"
    names = {item["metadata"]["name"] for item in played.platform.get("-n", NAMESPACE, kinds)["items"]}
    assert {"manager", "forge", "console"} <= names
    assert names & OWN == set()


def test_nobody_waits_for_accounts_with_the_installation(played: Played) -> None:
    statuses = [pod["status"] for pod in played.before["items"] if pod["status"]["phase"] != "Succeeded"]
    assert statuses
    assert all(one["ready"] and not one["restartCount"] for status in statuses for one in status["containerStatuses"])


def test_every_expectation_holds(played: Played) -> None:
    """Of the small variant, the last ones those of what is stored there."""
    story = played.story
    rows = {row["name"]: row for row in story.report.get("expectations", ())}
    assert rows, f"{story.talk[-3000:]}\n{story.output[-3000:]}"
    assert {name: row["measured"] for name, row in rows.items() if not row["passed"]} == {}
    assert [name for name, row in rows.items() if row["measured"] is None] == []
    assert (rows["lost"]["measured"], rows["duplicates"]["measured"]) == (0, 0)
    assert story.report["passed"]
    assert story.code == 0


def test_the_recording_is_complete_by_the_command_that_a_person_runs(played: Played) -> None:
    def ask(*words: str) -> Any:
        command = [sys.executable, "-m", "robotkube.cli", "recording", *words, "-o", "json"]
        surroundings = {**os.environ, "KUBECONFIG": str(played.platform.installer.kubeconfig)}
        done = subprocess.run(
            command, cwd=PROJECT, env=surroundings, capture_output=True, text=True, timeout=COMMANDS_SECONDS_MAX,
            check=False,
        )  # fmt: skip
        assert done.returncode == 0, f"{done.stderr}{done.stdout}"
        return json.loads(done.stdout)

    [recording] = ask("list")["recordings"]
    assert recording["state"] == "ended"
    proof = ask("verify", recording["recording"])
    assert {row["sealed"] for row in proof["manifests"]} == {True}
    assert proof["topics"]
    assert all(row["complete"] for row in proof["topics"])


def test_the_managers_task_gateway_is_at_the_broker(played: Played) -> None:
    chosen = ("-n", NAMESPACE, "-l", "app.kubernetes.io/name=manager")
    [pod] = played.platform.get(*chosen, "pods")["items"]
    page = f"/api/v1/namespaces/{NAMESPACE}/pods/{pod['metadata']['name']}:8081/proxy/metrics"
    metrics = played.platform.kubectl("get", "--raw", page)
    assert re.findall(r"^robotkube_task_gateway_connected (\S+)$", metrics, re.MULTILINE) == ["1.0"]
