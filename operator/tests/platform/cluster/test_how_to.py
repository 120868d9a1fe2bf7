"""The how-to `add an application`, word by word: its commands and files in a folder of their own, on the cluster."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from ci.folders import PROJECT
from tests.stages.platform.running_platform import Platform, eventually

pytestmark = pytest.mark.thorough

PAGE = PROJECT / "docs" / "how-to" / "add-an-application.md"
BLOCK = re.compile(r"^```(console|yaml|python) ?(\S*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FURTHER = "## To the end"
COMMAND_SECONDS_MAX = 420
TASK_NAMESPACE, TASK = "cloud-0", "greeting"
PODS = {"cloud-0/greeting-echo", "vehicle-00/greeting-listener", "vehicle-01/greeting-listener"}


@dataclass(frozen=True)
class Step:
    """A file to write (`path` and `text`) or a command to run (`text`, when `path` is empty)."""

    path: str
    text: str


def steps(part: int) -> Iterator[Step]:
    """What the page asks its reader to do, in order: its first part, or what follows its heading `To the end`."""
    parts = PAGE.read_text(encoding="utf-8").split(FURTHER)
    for kind, path, text in BLOCK.findall(parts[part]):
        if kind != "console":
            yield Step(path, text)
        else:
            yield from (Step("", line.removeprefix("$ ")) for line in text.splitlines())


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A copy of the two folders that the page names, with `robotkube` and `kubectl` as commands."""
    shutil.copytree(PROJECT / "charts" / "apps", tmp_path / "charts" / "apps")
    shutil.copytree(PROJECT / "registry", tmp_path / "registry")
    (tmp_path / "bin").mkdir()
    program = tmp_path / "bin" / "robotkube"
    program.write_text(f'#!/bin/sh\nexec "{PROJECT}/ci/python" -m robotkube.cli "$@"\n', encoding="utf-8")
    program.chmod(0o755)
    return tmp_path


def environment(platform: Platform, folder: Path) -> Mapping[str, str]:
    programs = [str(folder / "bin"), str(platform.installer.binaries), os.environ["PATH"]]
    return {**os.environ, "PATH": os.pathsep.join(programs), "KUBECONFIG": str(platform.installer.kubeconfig)}


def run(command: str, folder: Path, surroundings: Mapping[str, str]) -> None:
    done = subprocess.run(  # noqa: S602 - the page's own commands, as its reader types them
        *(command,),
        shell=True,
        cwd=folder,
        env=dict(surroundings),
        capture_output=True,
        text=True,
        timeout=COMMAND_SECONDS_MAX,
        check=False,
    )
    assert done.returncode == 0, f"$ {command}\n{done.stdout[-4000:]}\n{done.stderr[-4000:]}"


def running(platform: Platform) -> set[str]:
    """`<namespace>/<release>` of the application's pods that run."""
    pods = platform.get("pods", "-A", "-l", "app.kubernetes.io/name=text-relay")["items"]
    return {
        f"{pod['metadata']['namespace']}/{pod['metadata']['labels']['app.kubernetes.io/instance']}"
        for pod in pods
        if pod["status"]["phase"] == "Running" and not pod["metadata"]["namespace"].startswith("robotkube-suite-")
    }


def test_page_leads_from_nothing_to_running_pods(platform: Platform, folder: Path) -> None:
    surroundings = environment(platform, folder)
    todo = list(steps(0))
    assert [step.path for step in todo if step.path] == ["registry/applications/greeting.yaml", "task.yaml", "hear.py"]
    for step in todo:
        if step.path:
            (folder / step.path).write_text(step.text, encoding="utf-8")
            continue
        if "delete taskdescription" in step.text:
            assert running(platform) == PODS
        run(step.text, folder, surroundings)
    eventually("the pods are gone", lambda: not running(platform), seconds=90)
    assert f"{TASK_NAMESPACE}/{TASK}" not in platform.kubectl("get", "taskdescriptions", "-A")


def versions(platform: Platform, chart: str) -> dict[str, str]:
    """`<namespace>/<release>` -> version of the chart's releases whose pods are all new and ready."""
    deployments = platform.get("deployments", "-A", "-l", f"app.kubernetes.io/name={chart}")["items"]
    return {
        f"{item['metadata']['namespace']}/{item['metadata']['name']}": item["metadata"]["labels"][
            "app.kubernetes.io/version"
        ]
        for item in deployments
        if not item["metadata"]["namespace"].startswith("robotkube-suite-")
        and item["status"].get("observedGeneration") == item["metadata"]["generation"]
        and item["status"].get("readyReplicas")
        == item["status"].get("updatedReplicas")
        == item["status"].get("replicas")
        == 1
    }


@dataclass
class Reader:
    """Who follows the page to its end: each command with its seconds, and the state that the page promises after it."""

    platform: Platform
    folder: Path
    took: dict[str, float] = field(default_factory=dict)

    def follow(self, step: Step) -> None:
        """Write the step's file or run its command, and look at what must be true then."""
        if step.path:
            (self.folder / step.path).write_text(step.text, encoding="utf-8")
            return
        began = time.monotonic()
        run(step.text, self.folder, environment(self.platform, self.folder))
        self.took[step.text] = round(time.monotonic() - began, 1)
        for words, check in self._promises().items():
            if re.search(words, step.text):
                check()

    def _promises(self) -> Mapping[str, Callable[[], None]]:
        return {
            "a first delivery": lambda: self._see(
                "drive", {f"vehicle-{n}/delivery-drive": "0.1.0" for n in ("00", "01")}
            ),
            "other topic": self._see_one_vehicle,
            "submit delivery-order --watch": lambda: self._see("order", {"cloud-0/delivery-order-vehicle-00": "0.2.0"}),
            r"task withdraw \S+$": lambda: self._see("drive", {}),
            r"std_msgs\.msg": lambda: self._see("drive", {"vehicle-01/delivery-drive": "0.1.0"}),
        }

    def _see_one_vehicle(self) -> None:
        self._see("drive", {"vehicle-00/delivery-drive": "0.1.0"})
        settings = self.platform.kubectl("-n", "vehicle-00", "get", "configmap", "delivery-drive", "-o", "yaml")
        assert "/vehicles/vehicle_00/spoken" in settings

    def _see(self, service: str, expected: Mapping[str, str]) -> None:
        seen: dict[str, str] = {}

        def reached() -> bool:
            seen.clear()
            seen.update(versions(self.platform, f"delivery-{service}"))
            return seen == expected

        eventually(f"pods of {service} are {dict(expected)}", reached, seconds=120)


def test_a_strangers_application_goes_its_whole_way(platform: Platform, folder: Path) -> None:
    reader = Reader(platform, folder)
    try:
        for step in steps(1):
            reader.follow(step)
    finally:
        reports = PROJECT / "build" / "reports"
        reports.mkdir(parents=True, exist_ok=True)
        (reports / "strangers-way.json").write_text(json.dumps(reader.took, indent=2), encoding="utf-8")
        for task in ("delivery", "watch"):
            platform.kubectl("-n", TASK_NAMESPACE, "delete", "taskdescription", task, "--ignore-not-found")
        platform.kubectl("label", "node", "cloud-0", "robotkube.io/capability.planning-")
