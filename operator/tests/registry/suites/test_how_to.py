"""The example of docs/how-to/write-a-suite.md, run as it stands there, on charts of the platform."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from robotkube.registry.charts.adapters.chart_folders import pack
from robotkube.registry.suites.loops.custom import read_result
from robotkube.registry.suites.ports.suites import PodRun
from tests.stages.paths import REPOSITORY

PAGE = REPOSITORY / "docs" / "how-to" / "write-a-suite.md"
PROGRAM = re.compile(r"^```python short_grace\.py\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def run(chart: str, folder: Path) -> PodRun:
    [text] = PROGRAM.findall(PAGE.read_text(encoding="utf-8"))
    (folder / "request.json").write_text(json.dumps({"chart": chart}))
    packed = pack(REPOSITORY / "charts" / "apps" / chart, {chart: "image@sha256:0"})
    (folder / "chart.tgz").write_bytes(packed.archive)
    program = text.replace("/suite/", f"{folder}/")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=30, check=False)
    return PodRun(done.stdout + done.stderr, done.returncode)


@pytest.mark.parametrize(("chart", "passed", "seconds"), [("mqtt-bridge", True, 3), ("event-detector", False, 10)])
def test_the_example_judges(tmp_path: Path, chart: str, passed: bool, seconds: int) -> None:
    [check] = read_result(run(chart, tmp_path))
    assert (check.name, check.passed) == ("short-grace", passed)
    assert check.found == f"terminationGracePeriodSeconds is {seconds}"
    assert check.fix
