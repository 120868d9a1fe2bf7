"""A new version is judged by its results on an agent: by how often its topic comes, as a detector there counts, and by
what the kubelet sees of its container. One that shows them stays; one that runs and publishes nothing, and one whose
container ends once, are taken back."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from ci import publish
from ci.folders import PROJECT
from robotkube.registry.publication.loops.submitting import PUBLISHED, UNCHANGED
from tests.stages.platform.chart_versions import (
    UPDATED_SECONDS_MAX,
    changed,
    entry_after,
    publish_application,
    put_policy,
    submit,
    update_of,
)
from tests.stages.platform.running_platform import Platform, eventually
from tests.stages.platform.table_one import Stage
from tests.stages.ros.lidar_clouds import cloud

pytestmark = pytest.mark.thorough

CHART, SOURCE, SILENT, ENDING, GOOD = "object-detection", "0.2.3", "0.2.20", "0.2.21", "0.2.22"
VEHICLE = "vehicle-01"  # other tests leave versions behind that end on vehicle-02
RELEASE = f"{VEHICLE}/{CHART}-{VEHICLE}"
BRIDGE = f"{VEHICLE}/mqtt-bridge"
CLOUDS = "/vehicles/vehicle_01/lidar_center/pointcloud"
HERTZ = 5.0
RULE = "default: {successSeconds: 10, failureSeconds: 60}\n"
SUCCESS = """  success:
    probesOf: [object-detection]
    rates: [{topic: "/vehicles/{agent}/objects", atLeastHz: 2}]
    seconds: 30
"""
OBJECTS = "objects: {{ .Values.detection.objects }}"
ELSEWHERE = (
    'objects: {{ .Values.detection.objects }}{{ hasPrefix "/vehicles/vehicle_" .Values.detection.cloud | ternary '
    '"_elsewhere" "" }}'
)
WATCH = "detection-watch"
WATCHING = f"""apiVersion: registry.robotkube.io/v1alpha1
kind: Application
metadata:
  name: {WATCH}
spec:
  description: Says when a vehicle's own detection publishes too seldom
  provides: [operator/{WATCH}]
  parameters:
    type: object
    additionalProperties: false
    required: [vehicle]
    properties:
      vehicle: {{type: string, pattern: "^[a-z]([a-z0-9-]*[a-z0-9])?$", maxLength: 40, examples: [vehicle-00]}}
  services:
  - name: watch
    release: "{WATCH}-{{{{ parameters.vehicle }}}}"
    chart: {{name: event-detector, version: ">=0.2.0 <0.3.0"}}
    placement: {{agent: "{{{{ parameters.vehicle }}}}"}}
    values:
      detector:
        task: "{{{{ task.namespace }}}}/{{{{ task.name }}}}"
        topics:
        - name: "/vehicles/{{agent}}/objects"
          type: geometry_msgs/msg/PoseArray
        rules:
        - name: seldom
          kind: rate
          topic: "/vehicles/{{agent}}/objects"
          start_below_hz: 2
          stop_above_hz: 3
        - name: silent
          kind: absence
          topic: "/vehicles/{{agent}}/objects"
          seconds: 5
          agents: ["{{{{ parameters.vehicle }}}}"]
        reactions:
        - {{rule: seldom, kind: operator, application: environment-perception, parameters: {{sensor: roadside-0}}}}
        - {{rule: silent, kind: operator, application: environment-perception, parameters: {{sensor: roadside-0}}}}
"""
END_SOON = """
import subprocess, sys
program = "import os, signal, time; time.sleep(1); os.kill(1, signal.SIGTERM)"
quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
subprocess.Popen([sys.executable, "-c", program], start_new_session=True, **quiet)
"""


def sources(folder: Path) -> None:
    """The folders charts and registry of the project, and the application that watches."""
    shutil.copytree(PROJECT / "charts" / "apps", folder / "charts")
    shutil.copytree(PROJECT / "registry", folder / "registry")
    (folder / "registry" / "applications" / f"{WATCH}.yaml").write_text(WATCHING, encoding="utf-8")


def next_version(folder: Path, last: str, version: str, runs: str, skipped: str = "") -> None:
    """The chart as it is in `folder` (`last`), under another version with SUCCESS that replaces the one that `runs`."""
    entries = folder / "registry" / "charts" / CHART
    way = "" if runs == SOURCE else f", {SOURCE}"  # of who has the newest of this folder alone
    changed(folder / "charts" / CHART / "Chart.yaml", last, version)
    entry_after(
        entries,
        SOURCE,
        version,
        (f"version: {SOURCE}\n", f"version: {version}\n{SUCCESS}"),
        ("replaces: 0.2.2\n", f"replaces: {runs}\n"),
        ("skips: [0.1.2]", f"skips: [0.1.2{way}{skipped}]"),
    )


def taken_back(stage: Stage, version: str, before: str) -> str:
    """The message of the commit that takes a version back to the one before, once it is there."""
    eventually(
        f"{version} is taken back", lambda: stage.annotation(RELEASE, "chart-version") == before, UPDATED_SECONDS_MAX
    )
    revert = stage.commit_of(RELEASE)
    assert revert.trailers["Cause"] == ("revert",)
    return stage.message(revert)


def tried(stage: Stage, version: str) -> None:
    eventually(f"{version} is there", lambda: stage.annotation(RELEASE, "chart-version") == version)


@contextmanager
def seeing(stage: Stage) -> Iterator[None]:
    """The vehicle's lidar sends clouds."""
    with stage.publishing(BRIDGE, (CLOUDS, "sensor_msgs/msg/PointCloud2", cloud(points=2000)), hertz=HERTZ):
        yield


def is_known(platform: Platform, chart: str, version: str) -> bool:
    """Return whether the manager has read a catalogue with this version: tasks before that get the one before."""
    entries = platform.access.service_json("manager", "catalogue", 8080)["entries"]
    return any((entry["name"], entry["version"]) == (chart, version) for entry in entries if "version" in entry)


def test_a_version_stays_by_its_results_and_goes_by_them(platform: Platform, stage: Stage, tmp_path: Path) -> None:
    sources(tmp_path)
    publish.publish(platform.access.kubeconfig, extra=(CHART, "object-tracking"))
    assert publish_application(platform, tmp_path, WATCH).verdict in (PUBLISHED, UNCHANGED)
    eventually(f"the manager knows {CHART} {SOURCE}", lambda: is_known(platform, CHART, SOURCE))
    put_policy(stage, RULE, "updates-results")
    there = {"agents": [VEHICLE]}
    stage.submit("cloud-0", "results", application=CHART, parameters={"sensor": VEHICLE}, placement=there)
    stage.submit("cloud-0", "results-watch", application=WATCH, parameters={"vehicle": VEHICLE})
    stage.await_running(RELEASE, f"{VEHICLE}/{WATCH}-{VEHICLE}")
    runs = stage.annotation(RELEASE, "chart-version")  # the newest: tests of updates have published some
    with seeing(stage):
        stage.receive(BRIDGE, "/vehicles/vehicle_01/objects", "geometry_msgs/msg/PoseArray")

        next_version(tmp_path, SOURCE, SILENT, runs)
        template = tmp_path / "charts" / CHART / "templates" / "_app.tpl"
        changed(template, OBJECTS, ELSEWHERE)
        submit(platform, tmp_path, CHART)
        tried(stage, SILENT)
        said = taken_back(stage, SILENT, runs)
        assert "event of rule silent" in said or "event of rule seldom" in said, said

        next_version(tmp_path, SILENT, ENDING, runs, f", {SILENT}")
        changed(template, ELSEWHERE, OBJECTS)
        submit(platform, tmp_path, CHART)
        tried(stage, ENDING)
        stage.await_running(RELEASE)
        stage.run(RELEASE, END_SOON, seconds=30)
        said = taken_back(stage, ENDING, runs)
        assert "had container object-detection, which ended (" in said, said

        next_version(tmp_path, ENDING, GOOD, runs, f", {SILENT}, {ENDING}")
        submit(platform, tmp_path, CHART)
        tried(stage, GOOD)
        eventually("nothing is on trial", lambda: not update_of(platform, RELEASE), UPDATED_SECONDS_MAX)
        assert stage.annotation(RELEASE, "chart-version") == GOOD, "and nothing was unmeasured"
