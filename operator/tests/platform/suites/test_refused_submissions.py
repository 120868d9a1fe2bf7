"""Wrong charts submitted as a person would: the gate refuses them with the words of the suite whose task it was, and
nothing of them is published. Each chart and each suite for itself: test_suites.py, test_suite_interface.py."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from ci.folders import PROJECT
from robotkube.foundation.forge.adapters.git import GitClone
from tests.stages.platform.running_platform import Platform
from tests.stages.registry import wrong_charts, wrong_interfaces

WAIT_SECONDS = 540
FEW = ("privileged-pod", "undeclared-topic")
ALL = ("privileged-pod", "unpinned-image", "undeclared-topic", "wrong-type", "never-ready", "ignores-sigterm")
SUITES: Mapping[str, str] = {
    "privileged-pod": "static",
    "unpinned-image": "static",
    "undeclared-topic": "interface",
    "wrong-type": "interface",
    "never-ready": "install",
    "ignores-sigterm": "install",
}


def write(names: Sequence[str], folder: Path) -> None:
    for name in names:
        source = wrong_charts if name in wrong_charts.MISTAKES else wrong_interfaces
        source.wrong_chart(name, folder)


def submit(platform: Platform, names: Sequence[str], folder: Path) -> subprocess.CompletedProcess[str]:
    command = [str(PROJECT / "ci" / "python"), "-m", "robotkube.cli", "registry", "submit", *names]
    places = ["--charts", str(folder / "charts"), "--registry", str(folder / "registry")]
    return subprocess.run(
        [*command, *places, "--wait", str(WAIT_SECONDS), "--kubeconfig", str(platform.installer.kubeconfig)],
        env=dict(os.environ),
        capture_output=True,
        text=True,
        timeout=WAIT_SECONDS + 60,
        check=False,
    )


def catalogue(platform: Platform, folder: Path) -> set[str]:
    """Paths below charts/ and evidence/ on main of the catalogue."""
    account = ("gate", platform.password("gate"))
    clone = GitClone(platform.forge_url(), "robotkube/catalogue", *account, folder / "catalogue")
    return set(clone.files(clone.fetch(), ("charts", "evidence")))


@pytest.mark.parametrize("names", [FEW, pytest.param(ALL, marks=pytest.mark.thorough)])
def test_the_gate_refuses_wrong_charts_in_words(platform: Platform, names: Sequence[str], tmp_path: Path) -> None:
    write(names, tmp_path)
    before = catalogue(platform, tmp_path)
    done = submit(platform, names, tmp_path)
    said = done.stdout + done.stderr
    assert done.returncode == 1, said[-4000:]
    print(said)
    for name in names:
        refused = [line for line in said.splitlines() if name in line and SUITES[name] in line]
        assert refused, f"{name}: {SUITES[name]} is not named\n{said[-6000:]}"
    assert catalogue(platform, tmp_path) == before
