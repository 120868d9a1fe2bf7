"""`ci/python`: where it keeps what it makes."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from ci.cluster.embedded.host import followers
from ci.folders import PROJECT

pytestmark = pytest.mark.processes

PLACE = "import sys; print(sys.dont_write_bytecode, sys.pycache_prefix, sys.prefix, sep='\\n')"


def test_byte_code_is_kept_beside_the_environment_whatever_the_machine_says() -> None:
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", "PYTHONPYCACHEPREFIX": "/nowhere"}
    command = [str(PROJECT / "ci" / "python"), "-c", PLACE]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=True)
    forbidden, place, home = done.stdout.splitlines()
    assert (forbidden, Path(place)) == ("False", Path(home) / "bytecode")


def test_processes_of_a_clusters_host_keep_theirs_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPYCACHEPREFIX", "/somewhere")
    assert followers.environment()["PYTHONPYCACHEPREFIX"] == "/somewhere"
