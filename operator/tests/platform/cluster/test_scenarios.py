"""Every scenario from nothing to its report, as a person starts it: each on a cluster of its own machines."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from ci.cluster.embedded import cleaning
from ci.cluster.embedded.provider import Embedded
from ci.folders import PROJECT
from tests.stages.platform.running_platform import NAME

pytestmark = pytest.mark.thorough

SCENARIO_SECONDS_MAX = 1500
REPORTS = PROJECT / "build" / "reports"
STORIES = (
    ("three-vehicles", ()),
    ("intersection-support", ()),
    ("resource-conflict", ()),
    ("pose-point-cloud-db-recording", ("--variant", "manager-killed")),
    ("pose-point-cloud-db-recording", ("--variant", "mobile-network")),
    ("pose-point-cloud-db-recording", ("--variant", "narrow-uplink")),
    ("pose-point-cloud-db-recording", ("--variant", "hole-in-coverage")),
)


@pytest.mark.parametrize(
    ("name", "options"), STORIES, ids=[" ".join((name, *options[1:])) for name, options in STORIES]
)
def test_a_scenario_passes_from_nothing(no_demo: None, tmp_path: Path, name: str, options: tuple[str, ...]) -> None:
    Embedded(NAME, Path()).down()
    talk = tmp_path / "talk"
    command = [sys.executable, "-m", "scenarios.demo", name, *options, "--name", NAME]
    try:
        with talk.open("w") as said:
            done = subprocess.run(
                command, cwd=PROJECT, stdout=said, stderr=said, timeout=SCENARIO_SECONDS_MAX, check=False
            )
        assert done.returncode == 0, talk.read_text()[-6000:]
        document = json.loads((REPORTS / name / "report.json").read_text())
        assert [row for row in document["expectations"] if not row["passed"]] == []
    finally:
        Embedded(NAME, Path()).down()
    assert cleaning.leftovers(NAME) == ()
