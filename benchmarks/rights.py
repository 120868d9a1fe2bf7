"""How soon a merged link is a right at the broker, and a withdrawn one none any more, against the forge alone.

The forge's own part is from the push of main until its webhook arrives, in the same rounds: earlier nobody can know of
the merge. Writes `rights_applied_ms`, `rights_ended_ms` and `rights_announced_ms` to build/bench/links.json. Both must
keep to 1,000 ms, p95, and add at most ALLOWANCE_MS to the forge's part.
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
    """Both against the goal, and against the forge's part."""
    found = {name: quantiles(values) for name, values in measure().items()}
    record(RECORD, {f"rights_{name}_ms": asdict(values) for name, values in found.items()})
    floor = found["announced"].p95
    compared = []
    for name, word in (("merged link at the broker, p95", "applied"), ("withdrawn link's end, p95", "ended")):
        ours = found[word].p95
        compared.append(Comparison(name, "ms", ours, GOAL_MS, 1.0, "the goal"))
        bound = (floor + ALLOWANCE_MS) / floor
        compared.append(Comparison(name, "ms", ours, floor, bound, "push until the forge's webhook, p95"))
    return compared
