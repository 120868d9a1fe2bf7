"""The how-to `add an application`, word by word: its commands and files in a folder of their own, on the cluster."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

from ci.folders import PROJECT
from tests.stages.platform.running_platform import Platform, eventually

PAGE = PROJECT / "docs" / "how-to" / "add-an-application.md"
BLOCK = re.compile(r"^```(console|yaml) ?(\S*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
COMMAND_SECONDS_MAX = 420
TASK_NAMESPACE, TASK = "cloud-0", "greeting"
PODS = {"cloud-0/greeting-echo", "vehicle-00/greeting-listener", "vehicle-01/greeting-listener"}


@dataclass(frozen=True)
class Step:
    """A file to write (`path` and `text`) or a command to run (`text`, when `path` is empty)."""

    path: str
    text: str


def steps() -> Iterator[Step]:
    """What the page asks its reader to do, in order."""
    for kind, path, text in BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        if kind == "yaml":
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
    todo = list(steps())
    assert [step.path for step in todo if step.path] == ["registry/applications/greeting.yaml", "task.yaml"]
    for step in todo:
        if step.path:
            (folder / step.path).write_text(step.text, encoding="utf-8")
            continue
        if "delete taskdescription" in step.text:
            assert running(platform) == PODS
        run(step.text, folder, surroundings)
    eventually("the pods are gone", lambda: not running(platform), seconds=90)
    assert f"{TASK_NAMESPACE}/{TASK}" not in platform.kubectl("get", "taskdescriptions", "-A")
