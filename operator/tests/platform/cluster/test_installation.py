"""An installation is tried: `helm test` records one event and takes its task back, and a probe's pods leave nothing."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from typing import Any

import pytest

from robotkube.cli.main import main
from scenarios.definition import pose_topic
from scenarios.runner.platform.access import PLATFORM
from tests.stages.kubernetes.installed_chart import CHART
from tests.stages.platform.running_platform import Platform, eventually
from tests.stages.platform.table_one import Stage, pose

POSE_TYPE = "geometry_msgs/msg/PoseStamped"
HERTZ = 20.0
SECONDS_MAX = 60.0


def test_helm_test_records_one_event_and_withdraws_it(platform: Platform, stage: Stage) -> None:
    tasks = stage.tasks("cloud-0")
    with stage.publishing("vehicle-00/mqtt-bridge", (pose_topic("vehicle-00"), POSE_TYPE, pose(0.0)), hertz=HERTZ):
        began = time.monotonic()
        said = platform.installer.helm("test", PLATFORM, "-n", PLATFORM, seconds=90)
        assert time.monotonic() - began < SECONDS_MAX, said
    assert "Phase:          Succeeded" in said
    assert set(stage.tasks("cloud-0")) == set(tasks)
    eventually(
        "main asks for nothing of it",
        lambda: not any("installation-test" in stage.annotation(release, "tasks") for release in stage.releases()),
    )


def test_a_probe_answers_on_each_node_and_leaves_nothing(
    platform: Platform, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROBOTKUBE_HELM", str(platform.installer.binaries / "helm"))
    began = time.monotonic()
    main(
        [
            "preflight",
            "--probe",
            "--chart",
            str(CHART),
            "--kubeconfig",
            str(platform.installer.kubeconfig),
            "-o",
            "json",
        ]
    )
    assert time.monotonic() - began < SECONDS_MAX + 10
    checks: Mapping[str, Any] = {one["check"]: one for one in json.loads(capsys.readouterr().out)["checks"]}
    own = ("pull", "names", "clocks", "broker", "network-policies", "removed")
    assert {name: checks[name]["result"] for name in own} == dict.fromkeys(own, "ok"), [checks[name] for name in own]
    assert platform.kubectl("get", "namespace", "robotkube-probe", "--ignore-not-found") == ""
