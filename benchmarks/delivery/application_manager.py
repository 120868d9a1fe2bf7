"""What the application manager costs: a decision, merge latency, a storm of demands, recovery from SIGKILL.

Goals are numbers of the project, not ratios, so what is measured is set against its goal; all go to
build/bench/application-manager.json, latencies with n, p50, p95 and p99. Decisions are measured by decisions.py in
processes of their own, with main still and with main moving, and in turns with them those of an earlier revision
(`--against`). Merge latency is measured by the benchmark `gate`, storm and recovery by the module STORM of the tests.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.delivery import decisions as decide
from benchmarks.measuring.comparisons import Comparison, Quantiles, quantiles, record
from ci.errors import SetUpError
from ci.folders import PROJECT
from ci.machine import preparing

GateDecisions = Mapping[str, Sequence[float]]
"""Milliseconds of each, as benchmarks/delivery/decisions.py names them."""

RECORD = PROJECT / "build" / "bench" / "application-manager.json"
TESTS = PROJECT / "operator"  # the folder of the package `tests`
STORM = "tests.stages.delivery.manager.task_storm"
SOURCES = "operator/src"
BEFORE = "85ece35"  # the last revision before composition was computed from scratch
DECISIONS = 100
ROUNDS = 4
P50_RATIO_MAX = 1.1
P99_RATIO_MAX = 1.25
DECISION_GOAL_MS = 20.0
DEMANDS, NODES = 500, 1000
STORM_GOAL_SECONDS = 25.0
GROWTH_GOAL_MIB = 32.0
RECOVERY_GOAL_SECONDS = 5.0
SECONDS_MAX = 300


@contextmanager
def checkout(revision: str) -> Iterator[Path]:
    """The folder of a revision's sources while it is needed."""
    bundle = subprocess.run(
        ["git", "-C", str(PROJECT), "archive", revision, SOURCES], capture_output=True, timeout=SECONDS_MAX, check=False
    )
    if bundle.returncode:
        raise SetUpError(f"revision {revision} cannot be measured: {bundle.stderr.decode(errors='replace')[-500:]}")
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            ["tar", "--extract", "--directory", folder], input=bundle.stdout, timeout=SECONDS_MAX, check=True
        )
        yield Path(folder)


def decisions(project: Path, count: int = DECISIONS) -> GateDecisions:
    """What benchmarks/delivery/decisions.py measures of a checkout, in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(project / SOURCES)}
    return dict(_last_line([sys.executable, "-P", decide.__file__, str(count)], environment))


def known(revision: str) -> bool:
    """Return whether the repository has the revision."""
    asked = ["git", "-C", str(PROJECT), "cat-file", "-e", f"{revision}^{{commit}}"]
    return subprocess.run(asked, capture_output=True, timeout=SECONDS_MAX, check=False).returncode == 0


def in_turns(before: Path | None) -> tuple[list[GateDecisions], list[GateDecisions]]:
    """Rounds of decisions of this checkout and of the one before, measured in turns: slow minutes meet both."""
    ours: list[GateDecisions] = []
    theirs: list[GateDecisions] = []
    for _ in range(ROUNDS):
        ours.append(decisions(PROJECT))
        theirs += [decisions(before)] if before else []
    return ours, theirs


def together(rounds: Sequence[GateDecisions]) -> dict[str, Quantiles]:
    """Quantiles over all rounds."""
    names = rounds[0] if rounds else ()
    return {name: quantiles([value for one in rounds for value in one[name]]) for name in names}


def quietest(rounds: Sequence[GateDecisions], name: str) -> Quantiles:
    """Each quantile of the round in which it was least: what others do on the machine only ever adds to it."""
    each = [quantiles(one[name]) for one in rounds]
    return Quantiles(each[0].n, min(q.p50 for q in each), min(q.p95 for q in each), min(q.p99 for q in each))


def storm(demands: int, nodes: int) -> dict[str, Any]:
    """What the module STORM measures."""
    folders = os.pathsep.join(str(path) for path in (PROJECT, PROJECT / "operator" / "src", TESTS))
    environment = {**os.environ, "PYTHONPATH": folders, preparing.TOOLCHAIN_VARIABLE: str(preparing.tool_chain())}
    command = [sys.executable, "-m", STORM, str(demands), str(nodes)]
    return dict(_last_line(command, environment))


def _last_line(command: Sequence[str], environment: Mapping[str, str]) -> Any:
    """The JSON document in the last line that a command prints."""
    done = subprocess.run(
        command, env=environment, cwd=PROJECT, capture_output=True, text=True, timeout=SECONDS_MAX, check=False
    )
    if done.returncode:
        raise SetUpError(f"{' '.join(command)} ended with {done.returncode}: {done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def goal(name: str, unit: str, ours: float, at_most: float) -> Comparison:
    """What was measured, set against its goal."""
    return Comparison(name, unit, ours, at_most, 1.0, "the goal")


def compare(against: str = "") -> list[Comparison]:
    """A decision, a storm, recovery; each against its goal. Decisions also against those of revision `against`
    (default: BEFORE, where the repository has it)."""
    return [*compare_decisions(against), *compare_storms()]


def compare_decisions(against: str = "") -> list[Comparison]:
    """The decision alone."""
    revision = against or (BEFORE if known(BEFORE) else "")
    with checkout(revision) if revision else nullcontext() as before:
        ours, theirs = in_turns(before)
    measured = together(ours)
    record(RECORD, decision_record(measured, together(theirs), revision))
    still, moving = measured["still"], measured["moving"]
    return [
        goal(f"decision, p99 of {still.n}", "ms", still.p99, DECISION_GOAL_MS),
        goal(f"decision while main moves, p99 of {moving.n}", "ms", moving.p99, DECISION_GOAL_MS),
        *compare_revisions(ours, theirs, revision),
    ]


def compare_revisions(
    ours: Sequence[GateDecisions], before: Sequence[GateDecisions], revision: str
) -> Iterator[Comparison]:
    """Decisions set against those of the revision, each in its quietest round."""
    for name, words in (("still", "decision"), ("moving", "decision while main moves")) if before else ():
        now, then = quietest(ours, name), quietest(before, name)
        its = f"the same at {revision}, each in its quietest of {len(ours)} rounds"
        yield Comparison(f"{words}, p50", "ms", now.p50, then.p50, P50_RATIO_MAX, its)
        yield Comparison(f"{words}, p99", "ms", now.p99, then.p99, P99_RATIO_MAX, its)


def decision_record(ours: Mapping[str, Quantiles], before: Mapping[str, Quantiles], revision: str) -> dict[str, Any]:
    """The keys of the record."""
    document: dict[str, Any] = {
        "decision_ms": asdict(ours["still"]),
        "decision_p99_ms": ours["still"].p99,
        "decision_moving_ms": asdict(ours["moving"]),
        "decision_moving_p99_ms": ours["moving"].p99,
        "main_read_ms": asdict(ours["reading"]),
        "decision_before": revision,
    }
    names = {"still": "decision_before_ms", "moving": "decision_before_moving_ms"}
    return document | {key: asdict(before[name]) if before else None for name, key in names.items()}


def compare_storms() -> list[Comparison]:
    """The storm, once with the nodes of a small fleet and once with 1,000 on the API server."""
    small, large = storm(DEMANDS, 0), storm(DEMANDS, NODES)
    growth = small["rss_mib"][str(DEMANDS)] - small["rss_mib"]["100"]
    record(
        RECORD,
        {
            "storm_seconds": round(small["storm_seconds"], 2),
            "storm_demands_per_second": round(DEMANDS / small["storm_seconds"], 1),
            "storm_plans": small["plans"],
            "storm_rss_mib": small["rss_mib"],
            "storm_rss_growth_mib": round(growth, 1),
            "storm_1000_nodes_seconds": round(large["storm_seconds"], 2),
            "recovery_seconds": round(small["recovery_seconds"], 2),
            "recovery_1000_nodes_seconds": round(large["recovery_seconds"], 2),
        },
    )
    return [
        goal(f"storm of {DEMANDS} demands", "s", small["storm_seconds"], STORM_GOAL_SECONDS),
        goal("memory growth, demand 100 to 500", "MiB", growth, GROWTH_GOAL_MIB),
        goal("recovery to the first decision", "s", small["recovery_seconds"], RECOVERY_GOAL_SECONDS),
    ]


def record_merge_latency(tasks: Sequence[float], floor: Sequence[float], path: Path = RECORD) -> None:
    """What the benchmark `gate` measured of merge latency, in milliseconds."""
    ours, least = quantiles(tasks), quantiles(floor)
    record(
        path,
        {
            "accepted_to_merged_ms": asdict(ours),
            "accepted_to_merged_p95_ms": ours.p95,
            "forge_floor_ms": asdict(least),
            "forge_floor_p95_ms": least.p95,
        },
    )
