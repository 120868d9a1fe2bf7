"""The paper's use case, small, on a platform whose forge is others': a Gitea in another namespace, with what the page
about it has one make there. On a cluster `test` of its own, without the provider's admission, which reads the
catalogue where the chart's own forge keeps it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from ci import publish
from ci.cluster.embedded.admission import admission_files
from ci.folders import PROJECT
from ci.installation import CHART, NAMESPACE
from tests.stages.platform import managed_forge
from tests.stages.platform.bare_platform import bare_platform, install
from tests.stages.platform.managed_forge import ManagedForge
from tests.stages.platform.running_platform import SCENARIO, VARIANT, Platform, spoken
from tests.stages.platform.story import Story, play

pytestmark = pytest.mark.thorough

COMMANDS_SECONDS_MAX = 120


@dataclass(frozen=True)
class Played:
    """The platform, and the run."""

    platform: Platform
    story: Story


@pytest.fixture(scope="module")
def played(pytestconfig: pytest.Config, no_demo: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Played]:
    """Everything is published there, with images by the names that they have there, and tried anew."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(admission_files.VARIABLE, admission_files.OFF)
        with bare_platform(pytestconfig, VARIANT) as platform:
            with spoken(pytestconfig):
                forge = ManagedForge(platform)
                forge.start()
                forge.argocd()
                with forge.being_made():
                    install(platform, CHART, managed_forge.values())
                forge.pulled_from()
                accounts = publish.find_accounts(platform.installer.kubeconfig)
                images = managed_forge.images_there()
                kept = tmp_path_factory.mktemp("evidence")
                publish.publish_to(accounts, images, kept, print)
                story = play(platform, SCENARIO, VARIANT, tmp_path_factory.mktemp("story"))
            yield Played(platform, story)


def test_the_platform_has_none_of_its_own(played: Played) -> None:
    kinds = "deployments,statefulsets,services,persistentvolumeclaims"
    names = {item["metadata"]["name"] for item in played.platform.get("-n", NAMESPACE, kinds)["items"]}
    assert {"manager", "broker", "database", "rights"} <= names
    assert "forge" not in names


def test_every_expectation_holds(played: Played) -> None:
    """Of the small variant; its changes were proposed, checked and merged there."""
    story = played.story
    rows = {row["name"]: row for row in story.report.get("expectations", ())}
    assert rows, f"{story.talk[-3000:]}\n{story.output[-3000:]}"
    assert {name: row["measured"] for name, row in rows.items() if not row["passed"]} == {}
    assert [name for name, row in rows.items() if row["measured"] is None] == []
    assert story.report["passed"]
    assert story.code == 0
    assert len([entry for entry in story.report["audit"] if entry["event"] and entry["pull_request"]]) == 2


def test_pods_run_images_of_this_forge(played: Played) -> None:
    """By the names that they are asked for; a node that has one by another name as well may say that."""
    images = {container["image"] for pod in played.story.pods.values() for container in pod["spec"]["containers"]}
    assert images
    assert {image.partition("@")[0].rpartition("/")[0] for image in images} == {f"{managed_forge.HOST}/robotkube"}


def test_the_gate_has_signed_for_everything_on_main(played: Played) -> None:
    """By the command that a person runs, which finds the forge by itself."""
    command = [sys.executable, "-m", "robotkube.cli", "status", "-o", "json"]
    surroundings = {**os.environ, "KUBECONFIG": str(played.platform.installer.kubeconfig)}
    done = subprocess.run(
        command, cwd=PROJECT, env=surroundings, capture_output=True, text=True, timeout=COMMANDS_SECONDS_MAX,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{done.stderr}{done.stdout}"
    assert json.loads(done.stdout)["unchecked"] == []
