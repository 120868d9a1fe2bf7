"""How soon a merged link is a right at the broker, and a withdrawn one none any more, against the forge alone.

The forge's part is from the push of main until its webhook arrives, in the same rounds: earlier nobody can know of the
merge. Writes `rights_applied_ms`, `rights_ended_ms`, `rights_announced_ms` (the forge's part) and `rights_own_ms` (the
rest) to build/bench/links.json. Where the forge's part alone leaves no room for the goal, it is that and ALLOWANCE_MS.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import asdict

from benchmarks.links import RECORD
from benchmarks.measuring import Comparison, quantiles, record
from ci import preparing
from ci.errors import SetUpError
from ci.folders import PROJECT

ROUNDS = 20
GOAL_MS = 1000.0
ALLOWANCE_MS = 500.0
SECONDS_MAX = 600


def measure(count: int = ROUNDS) -> dict[str, list[float]]:
    """Milliseconds of each round, by what was measured."""
    folders = os.pathsep.join(str(path) for path in (PROJECT, PROJECT / "operator" / "src", PROJECT / "operator"))
    environment = {**os.environ, "PYTHONPATH": folders, preparing.TOOLCHAIN_VARIABLE: str(preparing.tool_chain())}
    command = [sys.executable, "-m", "tests.stages.delivery.rights_latency", str(count)]
    done = subprocess.run(
        command, env=environment, cwd=PROJECT, capture_output=True, text=True, timeout=SECONDS_MAX, check=False
    )
    if done.returncode:
        raise SetUpError(f"{command[2]} ended with {done.returncode}: {done.stderr[-2000:]}")
    milliseconds: dict[str, list[float]] = json.loads(done.stdout.splitlines()[-1])
    return milliseconds


def compare() -> list[Comparison]:
    """Both against the forge's part, and what comes after it against the goal."""
    found = {name: quantiles(values) for name, values in measure().items()}
    record(RECORD, {f"rights_{name}_ms": asdict(values) for name, values in found.items()})
    floor = found["announced"].p95
    bound = max(GOAL_MS, floor + ALLOWANCE_MS) / floor
    baseline = "push until the forge's webhook, p95"
    return [
        Comparison("merged link at the broker, p95", "ms", found["applied"].p95, floor, bound, baseline),
        Comparison("withdrawn link's end, p95", "ms", found["ended"].p95, floor, bound, baseline),
        Comparison("announced link at the broker, p95", "ms", found["own"].p95, GOAL_MS, 1.0, "the goal"),
    ]
