"""The how-to `use the event detector alone`, word by word, in a namespace that RobotKube knows nothing of."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from ci.folders import PROJECT
from tests.stages.platform import suite_namespaces
from tests.stages.platform.running_platform import Platform

pytestmark = pytest.mark.thorough

PAGE = PROJECT / "docs" / "how-to" / "use-the-detector-alone.md"
BLOCK = re.compile(r"^```(console|yaml|python) ?(\S*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
COMMAND_SECONDS_MAX = 300
AGENT, NAMESPACE, DETECTOR = "vehicle-02", "my-robots", "my-detector"
TAKING_THE_LABEL = "robotkube.io/agent-"  # the platform's own node keeps it


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A copy of the charts, which the page packs."""
    shutil.copytree(PROJECT / "charts", tmp_path / "charts", symlinks=True)
    return tmp_path


@pytest.fixture
def surroundings(platform: Platform) -> Iterator[Mapping[str, str]]:
    """Environment of the page's reader; the namespace is gone afterwards, also when a step failed."""
    programs = os.pathsep.join([str(platform.installer.binaries), os.environ["PATH"]])
    [node] = platform.get("nodes", "-l", f"robotkube.io/agent={AGENT}")["items"]
    images = suite_namespaces.images()
    yield {
        **os.environ,
        "PATH": programs,
        "KUBECONFIG": str(platform.installer.kubeconfig),
        "IMAGE": images["event-detector"],
        "BROKER_IMAGE": images["mosquitto"],
        "NODE": node["metadata"]["name"],
        "AGENT": AGENT,
    }
    platform.kubectl("delete", "namespace", NAMESPACE, "--ignore-not-found", "--timeout=120s")


def run(command: str, folder: Path, surroundings: Mapping[str, str]) -> str:
    done = subprocess.run(  # noqa: S602 - the page's own commands, as its reader types them
        command,
        shell=True,
        cwd=folder,
        env=dict(surroundings),
        capture_output=True,
        text=True,
        timeout=COMMAND_SECONDS_MAX,
        check=False,
    )
    assert done.returncode == 0, f"$ {command}\n{done.stdout[-4000:]}\n{done.stderr[-4000:]}"
    return done.stdout


def pods(platform: Platform) -> dict[str, int]:
    """Identity -> restarts of the detector's pods."""
    items = platform.get("pods", "-n", NAMESPACE, "-l", f"app.kubernetes.io/instance={DETECTOR}")["items"]
    return {pod["metadata"]["uid"]: sum(c["restartCount"] for c in pod["status"]["containerStatuses"]) for pod in items}


def test_the_page_leads_from_nothing_to_an_event_and_a_changed_rule(
    platform: Platform, folder: Path, surroundings: Mapping[str, str]
) -> None:
    statuses: list[dict[str, Any]] = []
    notification: dict[str, Any] = {}
    before: dict[str, int] = {}
    for _, path, text in BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        if path:
            (folder / path).write_text(text, encoding="utf-8")
            continue
        for line in text.splitlines():
            if line.endswith(TAKING_THE_LABEL):
                continue
            if "helm uninstall" in line:
                assert pods(platform) == before, "the pod did not stay"
            said = run(line.removeprefix("$ "), folder, surroundings)
            if "paho.mqtt" in line:
                notification = json.loads(said)
            elif "/status" in line:
                statuses.append(json.loads(said))
                before = before or pods(platform)
    assert (notification["rule"], notification["detector"]) == ("warm", f"{NAMESPACE}/{DETECTOR}")
    first, last = statuses
    assert first["state"] == last["state"] == "active"
    assert [status["not_ready"] for status in statuses] == ["", ""]
    assert [status["settings"]["refused"] for status in statuses] == ["", ""]
    assert last["settings"]["applied"] > first["settings"]["applied"]
    assert last["topics"]["/temperature"]["received"] > first["topics"]["/temperature"]["received"] > 0
    assert first["started"] == last["started"]
