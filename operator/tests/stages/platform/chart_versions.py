"""Chart versions that a test writes, publishes and follows to the agents."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

from ci import publish
from ci.folders import PROJECT
from ci.images.image_lock import lock_file, read_lock
from robotkube.cli.registry.submit import submit_sources
from robotkube.registry.publication.adapters.submission_folders import read_sources
from robotkube.registry.publication.loops.submitting import SubmissionOutcome
from scenarios.runner.platform import proposing
from tests.stages.platform.running_platform import Platform
from tests.stages.platform.table_one import Stage

POLICY = "policies/updates.yaml"
SUBMIT_SECONDS_MAX = 420
UPDATED_SECONDS_MAX = 180.0
ROBOTKUBE = (str(PROJECT / "ci" / "python"), "-m", "robotkube.cli")


def changed(path: Path, old: str, new: str) -> None:
    """Write `new` in the place of `old`, which the file must have."""
    text = path.read_text(encoding="utf-8")
    assert old in text, f"{path}: {old}"
    path.write_text(text.replace(old, new), encoding="utf-8")


def entry_after(entries: Path, last: str, version: str, *changes: tuple[str, str]) -> None:
    """Write the entry of a version: the `last` one's, with each of the changes, whose first text it must have."""
    path = entries / f"{version}.yaml"
    path.write_text((entries / f"{last}.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    for old, new in changes:
        changed(path, old, new)


def submit(platform: Platform, folder: Path, chart: str) -> None:
    """Publish a chart of the folders charts and registry below `folder`, by the command."""
    places = ["--charts", str(folder / "charts"), "--registry", str(folder / "registry")]
    options = ["--wait", str(SUBMIT_SECONDS_MAX), "--kubeconfig", str(platform.installer.kubeconfig)]
    done = subprocess.run(
        [*ROBOTKUBE, "registry", "submit", chart, *places, *options],
        env=dict(os.environ),
        capture_output=True,
        text=True,
        timeout=SUBMIT_SECONDS_MAX + 60,
        check=False,
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]


def publish_application(platform: Platform, folder: Path, application: str) -> SubmissionOutcome:
    """Publish an application that runs by itself, with the approval of another person."""
    accounts = publish.find_accounts(platform.access.kubeconfig)
    images = {image.name: image.reference for image in read_lock(lock_file())}
    sources = read_sources((), (application,), folder / "charts", folder / "registry", images)
    approve = publish.approval(accounts.person)
    return submit_sources(accounts.charts, sources, lambda line: None, SUBMIT_SECONDS_MAX, opened=approve)


def put_policy(stage: Stage, text: str, topic: str) -> None:
    """Bring another policy of updates to main, by a person's pull request, unless it stands there already."""
    stage.deployment.fetch()
    if stage.deployment.file(POLICY) != text:
        proposing.change(stage.deployment, POLICY, text, "policy(updates): who is first, and soon", topic)


def update_of(platform: Platform, release: str) -> str:
    """The column UPDATE of a release."""
    options = ["--output", "json", "--kubeconfig", str(platform.installer.kubeconfig)]
    command = [*ROBOTKUBE, "release", "list", *options]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
    rows = {row["release"]: row["update"] for row in json.loads(shown)["releases"]}
    return str(rows[release])
