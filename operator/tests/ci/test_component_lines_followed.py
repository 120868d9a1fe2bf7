"""Pods of an installation followed by a program that says what kubectl says."""

from __future__ import annotations

import json
import stat
import sys
from pathlib import Path
from typing import Any

import pytest

from ci import component_lines
from tests.stages.kubernetes.component_pods import pod
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

PROGRAM = """#!{python}
import sys, time
if "events" in sys.argv:
    print('{{"items": []}}')
    sys.exit()
for document in {documents!r}:
    print(document, flush=True)
time.sleep(60)
"""


def kubectl(folder: Path, *events: tuple[str, Any]) -> str:
    """A program that says this of pods, as kubectl does, and goes on watching."""
    written = [json.dumps({"type": kind, "object": one}) for kind, one in events]
    path = folder / "kubectl"
    path.write_text(PROGRAM.format(python=sys.executable, documents=written))
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def test_pods_of_other_namespaces_are_nobodys_business(tmp_path: Path) -> None:
    robot = pod("bag-player-0", ready=True, namespace="vehicle-00")
    events = [("ADDED", pod("bag-player-0", namespace="vehicle-00")), ("MODIFIED", robot), ("ADDED", pod("gate-0"))]
    program = kubectl(tmp_path, *events, ("MODIFIED", pod("gate-0", ready=True)), ("ADDED", pod("broker-0")))
    said: list[str] = []
    with component_lines.following([program], ["robotkube"], said.append) as components:
        until(lambda: bool(components.hanging()), "the last pod is seen")
    assert [line.partition(" after")[0] for line in said] == ["gate: ready"]
    assert components.hanging() == ("broker is not ready: pod broker-0: Running, containers with unready status",)


def test_an_installation_goes_on_when_nobody_can_be_followed(tmp_path: Path) -> None:
    path = tmp_path / "kubectl"
    path.write_text("#!/bin/sh\nexit 1\n")
    path.chmod(0o755)
    with component_lines.following([str(path)], ["robotkube"], pytest.fail) as components:
        assert components.hanging() == ()
