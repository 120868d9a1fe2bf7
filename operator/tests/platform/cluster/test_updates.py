"""A version that passed every suite and fails on a vehicle: one agent has tried it, a commit takes it back, the others
never saw it, and its digest is not tried again."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from pathlib import Path

import pytest

from ci import publish
from ci.folders import PROJECT
from scenarios.runner import proposing
from tests.stages.platform.running_platform import Platform, eventually
from tests.stages.platform.table_one import Stage

pytestmark = pytest.mark.thorough

CHART, GOOD, BAD = "object-detection", "0.2.2", "0.2.5"
VEHICLES = ("vehicle-00", "vehicle-01", "vehicle-02")
RELEASES = [f"{vehicle}/{CHART}-{vehicle}" for vehicle in VEHICLES]
POLICY = "policies/updates.yaml"
RULE = "default: {canary: true, successSeconds: 5, failureSeconds: 20, threshold: 1.0, revert: true}\n"
SUBMIT_SECONDS_MAX = 420
UPDATED_SECONDS_MAX = 180.0
WATCHED_SECONDS = 30.0
COMMAND = "command: [robotkube-object-detection]\n"
FIELD_ONLY = (
    '{{- if hasPrefix "/vehicles/vehicle_" .Values.detection.cloud }}\n'
    'command: [python3, -c, "raise SystemExit(1)"]\n'
    "{{- else }}\n" + COMMAND + "{{- end }}\n"
)


def bad_version(folder: Path) -> None:
    """The chart as it is, but for vehicles' own clouds, which no room has: there it ends at once."""
    shutil.copytree(PROJECT / "charts" / "apps", folder / "charts")
    shutil.copytree(PROJECT / "registry", folder / "registry")
    chart, entries = folder / "charts" / CHART, folder / "registry" / "charts" / CHART
    changed(chart / "Chart.yaml", GOOD, BAD)
    changed(chart / "templates" / "_app.tpl", COMMAND, FIELD_ONLY)
    text = (entries / f"{GOOD}.yaml").read_text(encoding="utf-8")
    for old, new in ((f"version: {GOOD}", f"version: {BAD}"), ("replaces: 0.2.1", f"replaces: {GOOD}")):
        assert old in text
        text = text.replace(old, new)
    (entries / f"{BAD}.yaml").write_text(text, encoding="utf-8")


def changed(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def submit(platform: Platform, folder: Path) -> None:
    command = [str(PROJECT / "ci" / "python"), "-m", "robotkube.cli", "registry", "submit", CHART]
    places = ["--charts", str(folder / "charts"), "--registry", str(folder / "registry")]
    options = ["--wait", str(SUBMIT_SECONDS_MAX), "--kubeconfig", str(platform.installer.kubeconfig)]
    done = subprocess.run(
        [*command, *places, *options],
        env=dict(os.environ),
        capture_output=True,
        text=True,
        timeout=SUBMIT_SECONDS_MAX + 60,
        check=False,
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]


def put_policy(stage: Stage, text: str, topic: str) -> None:
    stage.deployment.fetch()
    proposing.change(stage.deployment, POLICY, text, "policy(updates): one agent first, and soon", topic)


def versions(stage: Stage) -> list[str]:
    """The chart's version that main gives each release."""
    return [stage.annotation(release, "chart-version") for release in RELEASES]


def test_a_version_that_fails_in_the_field_is_taken_back(platform: Platform, stage: Stage, tmp_path: Path) -> None:
    publish.publish(platform.access.kubeconfig, extra=(CHART,))
    put_policy(stage, RULE, "updates-soon")
    for vehicle in VEHICLES:
        asked = {"application": CHART, "parameters": {"sensor": vehicle}, "placement": {"agents": [vehicle]}}
        stage.submit("cloud-0", f"field-{vehicle}", **asked)
    stage.await_running(*RELEASES)
    eventually("all have the good version", lambda: set(versions(stage)) == {GOOD}, UPDATED_SECONDS_MAX)

    bad_version(tmp_path)
    submit(platform, tmp_path)
    eventually("one agent tries the new version", lambda: versions(stage).count(BAD) == 1, UPDATED_SECONDS_MAX)
    canary = RELEASES[versions(stage).index(BAD)]
    assert stage.commit_of(canary).trailers["Cause"] == ("update",)
    eventually("it is taken back", lambda: set(versions(stage)) == {GOOD}, UPDATED_SECONDS_MAX)
    revert = stage.commit_of(canary)
    assert revert.trailers["Cause"] == ("revert",)
    assert BAD in stage.message(revert)

    stage.await_running(*RELEASES)
    end = time.monotonic() + WATCHED_SECONDS
    while time.monotonic() < end:
        assert set(versions(stage)) == {GOOD}
        time.sleep(1)
    updates = [commit for commit in stage.commits() if commit.trailers.get("Cause") == ("update",)]
    others = {f"releases/{release}.yaml" for release in RELEASES if release != canary}
    assert [commit.sha for commit in updates if others & set(commit.paths)] == []
