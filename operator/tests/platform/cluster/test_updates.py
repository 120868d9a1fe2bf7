"""A version that passed every suite and whose image does not start on a vehicle: one agent has tried it, a commit takes
it back, the others never saw it, and its digest is not tried again. One that runs there is taken back by its
results. One that dies on a vehicle that was offline meanwhile is taken back for this vehicle alone."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import pytest

from ci import publish
from ci.folders import PROJECT
from robotkube.foundation.documents.core.times import time_text
from tests.stages.platform.chart_versions import (
    UPDATED_SECONDS_MAX,
    changed,
    entry_after,
    put_policy,
    submit,
    update_of,
)
from tests.stages.platform.running_platform import Platform, eventually
from tests.stages.platform.table_one import Stage

pytestmark = pytest.mark.thorough

CHART, GOOD, BAD, MEASURED = "object-detection", "0.2.3", "0.2.5", "0.2.6"
WATCHED_RULE = "field-trial"
VEHICLES = ("vehicle-00", "vehicle-01", "vehicle-02")
RELEASES = [f"{vehicle}/{CHART}-{vehicle}" for vehicle in VEHICLES]
RULE = "default: {first: [vehicle-02], successSeconds: 120, failureSeconds: 20}\n"
LATE, LATE_VEHICLE = "0.2.7", "vehicle-02"
LATE_RULE = "default: {first: [vehicle-00], successSeconds: 10, failureSeconds: 30}\n"
LOST_SECONDS_MAX = 120.0  # 50 s until Kubernetes says that the node is not ready
WATCHED_SECONDS = 30.0
IMAGE, OTHER = "object-detection", "object-tracking"  # which does not have the command
LATE_ONLY = (
    f'image: {{{{ hasPrefix "/vehicles/vehicle_02/" .Values.detection.cloud | ternary "{OTHER}" "{IMAGE}" }}}}\n'
)
FIELD_ONLY = f'image: {{{{ hasPrefix "/vehicles/vehicle_" .Values.detection.cloud | ternary "{OTHER}" "{IMAGE}" }}}}\n'


def bad_version(folder: Path) -> None:
    """The chart as it is, but for vehicles' own clouds, which no test namespace has: there its image is another one."""
    shutil.copytree(PROJECT / "charts" / "apps", folder / "charts")
    shutil.copytree(PROJECT / "registry", folder / "registry")
    chart, entries = folder / "charts" / CHART, folder / "registry" / "charts" / CHART
    changed(chart / "Chart.yaml", GOOD, BAD)
    changed(chart / "Chart.yaml", f"robotkube.io/images: {IMAGE}", f"robotkube.io/images: {IMAGE} {OTHER}")
    changed(chart / "templates" / "_app.tpl", f"image: {IMAGE}\n", FIELD_ONLY)
    entry_after(
        entries,
        GOOD,
        BAD,
        (f"version: {GOOD}", f"version: {BAD}"),
        ("replaces: 0.2.2", f"replaces: {GOOD}"),
        (f"images: [{IMAGE}]", f"images: [{IMAGE}, {OTHER}]"),
    )


def measured_version(folder: Path) -> None:
    """The version after the bad one: it runs everywhere, and its entry says which events it must not lead to."""
    chart, entries = folder / "charts" / CHART, folder / "registry" / "charts" / CHART
    changed(chart / "Chart.yaml", BAD, MEASURED)
    changed(chart / "Chart.yaml", f"robotkube.io/images: {IMAGE} {OTHER}", f"robotkube.io/images: {IMAGE}")
    changed(chart / "templates" / "_app.tpl", FIELD_ONLY, f"image: {IMAGE}\n")
    success = f"version: {MEASURED}\n  success: {{noEventOf: [{WATCHED_RULE}], seconds: 120}}"
    entry_after(
        entries,
        BAD,
        MEASURED,
        (f"version: {BAD}", success),
        (f"replaces: {GOOD}", f"replaces: {BAD}"),
        (f"images: [{IMAGE}, {OTHER}]", f"images: [{IMAGE}]"),
    )


def late_version(folder: Path) -> None:
    """The chart as it is, but for one vehicle's own cloud; it follows whatever version stands."""
    shutil.copytree(PROJECT / "charts" / "apps", folder / "charts")
    shutil.copytree(PROJECT / "registry", folder / "registry")
    chart, entries = folder / "charts" / CHART, folder / "registry" / "charts" / CHART
    changed(chart / "Chart.yaml", GOOD, LATE)
    changed(chart / "Chart.yaml", f"robotkube.io/images: {IMAGE}", f"robotkube.io/images: {IMAGE} {OTHER}")
    changed(chart / "templates" / "_app.tpl", f"image: {IMAGE}\n", LATE_ONLY)
    entry_after(
        entries,
        GOOD,
        LATE,
        (f"version: {GOOD}", f"version: {LATE}"),
        ("replaces: 0.2.2", f"replaces: {MEASURED}"),
        ("skips: [", f"skips: [{BAD}, {GOOD}, "),
        (f"images: [{IMAGE}]", f"images: [{IMAGE}, {OTHER}]"),
    )


def versions(stage: Stage) -> list[str]:
    """The chart's version that main gives each release."""
    return [stage.annotation(release, "chart-version") for release in RELEASES]


def ask_for_all(stage: Stage, name: str) -> None:
    """The chart on every vehicle, for its own cloud."""
    for vehicle in VEHICLES:
        asked = {"application": CHART, "parameters": {"sensor": vehicle}, "placement": {"agents": [vehicle]}}
        stage.submit("cloud-0", f"{name}-{vehicle}", **asked)


def test_a_version_that_fails_in_the_field_is_taken_back(platform: Platform, stage: Stage, tmp_path: Path) -> None:
    publish.publish(platform.access.kubeconfig, extra=(CHART,))
    put_policy(stage, RULE, "updates-soon")
    ask_for_all(stage, "field")
    stage.await_running(*RELEASES)
    eventually("all have the good version", lambda: set(versions(stage)) == {GOOD}, UPDATED_SECONDS_MAX)

    bad_version(tmp_path)
    submit(platform, tmp_path, CHART)
    eventually("one agent tries the new version", lambda: versions(stage).count(BAD) == 1, UPDATED_SECONDS_MAX)
    canary = f"vehicle-02/{CHART}-vehicle-02"
    assert stage.annotation(canary, "chart-version") == BAD
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

    measured_version(tmp_path)
    submit(platform, tmp_path, CHART)
    sentence = f"nobody watches it for events of {WATCHED_RULE}"
    eventually("the canary is healthy", lambda: sentence in update_of(platform, canary), UPDATED_SECONDS_MAX)
    assert sorted(versions(stage)) == [GOOD, GOOD, MEASURED]
    event = {"rule": WATCHED_RULE, "id": "field-trial-1", "trace": "f" * 32, "time": time_text(time.time_ns())}
    stage.submit("vehicle-02", "field-trial", application="nothing-of-this-name", event=event)
    eventually("it is taken back", lambda: set(versions(stage)) == {GOOD}, UPDATED_SECONDS_MAX)
    revert = stage.commit_of(canary)
    assert revert.trailers["Cause"] == ("revert",)
    assert f"{MEASURED} back: {canary} had an event" in stage.message(revert)


def is_ready(platform: Platform, node: str) -> bool:
    """Return whether Kubernetes says that the node is ready."""
    conditions = platform.get("node", node)["status"]["conditions"]
    return any(condition["type"] == "Ready" and condition["status"] == "True" for condition in conditions)


def settled(platform: Platform, stage: Stage) -> str:
    """The one version that all releases have and that no update concerns any more; empty while there is none."""
    standing = set(versions(stage))
    done = len(standing) == 1 and not any(update_of(platform, release) for release in RELEASES)
    return standing.pop() if done else ""


def test_what_dies_on_a_vehicle_that_was_offline_is_taken_back_there_alone(
    platform: Platform, stage: Stage, tmp_path: Path
) -> None:
    publish.publish(platform.access.kubeconfig, extra=(CHART,))
    put_policy(stage, LATE_RULE, "updates-late")
    ask_for_all(stage, "late")
    late = f"{LATE_VEHICLE}/{CHART}-{LATE_VEHICLE}"
    node = stage.await_running(*RELEASES)[late].node
    before = eventually("all have one version", lambda: settled(platform, stage), UPDATED_SECONDS_MAX)
    assert before != LATE

    late_version(tmp_path)
    with stage.stopped(node):
        eventually("the vehicle is offline", lambda: not is_ready(platform, node), LOST_SECONDS_MAX)
        submit(platform, tmp_path, CHART)
        eventually("the others have it", lambda: versions(stage) == [LATE, LATE, before], UPDATED_SECONDS_MAX)
        others = [release for release in RELEASES if release != late]
        eventually(
            "it has succeeded there",
            lambda: not any(update_of(platform, release) for release in others),
            UPDATED_SECONDS_MAX,
        )
        assert "offline" in update_of(platform, late)
    eventually("who is back gets it", lambda: versions(stage) == [LATE, LATE, LATE], UPDATED_SECONDS_MAX)
    eventually("it is taken back there", lambda: versions(stage) == [LATE, LATE, before], UPDATED_SECONDS_MAX)
    revert = stage.commit_of(late)
    assert revert.trailers["Cause"] == ("revert",)
    assert "Reverts" not in revert.trailers, "no commit is undone: others keep the version"
    assert [path for path in revert.paths if path.startswith("releases/")] == [f"releases/{late}.yaml"]
    stage.await_running(*RELEASES)
    end = time.monotonic() + WATCHED_SECONDS
    while time.monotonic() < end:
        assert versions(stage) == [LATE, LATE, before]
        time.sleep(1)
    assert f"back on {LATE_VEHICLE}" in update_of(platform, late)
