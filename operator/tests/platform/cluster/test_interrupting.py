"""`make demo` ended by Ctrl-C in its steps: it says so, and `make down` leaves nothing of it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ci.cluster.embedded import cleaning
from ci.cluster.embedded.provider import Embedded
from ci.folders import PROJECT
from tests.stages.platform.running_platform import NAME, SCENARIO

pytestmark = pytest.mark.thorough

REACHED_SECONDS_MAX = 600.0
ENDED_SECONDS_MAX = 60.0
INTERRUPTED = 130
# A line that is printed when the step has begun, and how long to let it work.
MOMENTS = {
    "tool chain": ("] tool chain ...", 0.0),
    "cluster": ("] control plane and containerd ...", 0.5),
    "Argo CD": ("] Argo CD ...", 2.0),
    "platform": ("] platform ...", 5.0),
    "catalogue": ("] catalogue ...", 1.0),
    "scenario": ("] scenario ...", 15.0),
}


@pytest.fixture(autouse=True)
def alone(no_demo: None) -> None:
    """Each starts from nothing."""
    Embedded(NAME, Path()).down()


@pytest.mark.parametrize("moment", MOMENTS)
def test_down_after_an_interrupt_leaves_nothing(tmp_path: Path, moment: str) -> None:
    line, seconds = MOMENTS[moment]
    talk = tmp_path / "talk"
    command = [sys.executable, "-m", "scenarios.demo", str(SCENARIO), "--name", NAME, "--set", "vehicles=3"]
    with talk.open("w") as said:
        process = subprocess.Popen(command, cwd=PROJECT, stdout=said, stderr=said, start_new_session=True)
        try:
            wait_for(line, talk, process)
            time.sleep(seconds)
            os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to everything in the foreground
            code = process.wait(ENDED_SECONDS_MAX)
        finally:
            process.kill()
            process.wait()
    assert code == INTERRUPTED, talk.read_text()[-2000:]
    assert "Traceback" not in talk.read_text()
    assert talk.read_text().rstrip().splitlines()[-1].startswith("interrupted")
    down = [sys.executable, "-m", "ci.cluster", "down", "--name", NAME]
    subprocess.run(down, cwd=PROJECT, check=True, timeout=ENDED_SECONDS_MAX)
    assert cleaning.leftovers(NAME) == ()


def wait_for(line: str, talk: Path, process: subprocess.Popen[bytes]) -> None:
    """Wait until the demo says that it is there."""
    end = time.monotonic() + REACHED_SECONDS_MAX
    while line not in talk.read_text():
        assert process.poll() is None, talk.read_text()[-2000:]
        assert time.monotonic() < end, talk.read_text()[-2000:]
        time.sleep(0.1)
