"""What TLS costs in processor time: bridges and broker, recorder and database, each with and without, in turns.

    python3 -m benchmarks.broker.encryption [--turns 2] [--seconds 14]

Three vehicles at 100 Hz, one of them with point clouds; ten seconds of two vehicles that are stored. Writes `tls_cost`
and `database_tls_cost` to build/bench/event-detector.json: the ratio with / without of all parts together, of each, and
the processor time of both, in % of one core and in seconds.
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Sequence
from typing import Any

from benchmarks.bridges.data_path import DataPath, measure_lossless
from benchmarks.detector.recording import cpu_seconds
from benchmarks.measuring.comparisons import Comparison, record
from ci.folders import PROJECT
from ci.machine import preparing

RECORD = PROJECT / "build" / "bench" / "event-detector.json"
VEHICLES, LIDARS, TURNS, SECONDS = 3, 1, 2, 14.0
PARTS = ("vehicle bridges", "cloud bridge", "broker")
STORING = ("recorder", "database")
STORING_TURNS = 4
RATIO_MAX = 1.6


class EncryptedDataPath(DataPath):
    """Bridges and broker speak TLS."""

    encrypted = True


def cpu_percent(kind: type[DataPath], seconds: float = SECONDS) -> dict[str, float]:
    """Processor time of each part in % of one core. SetUpError when poses or clouds were lost."""
    run = measure_lossless(lambda folder: kind(folder, VEHICLES, LIDARS, seconds, clouds=True), kind.__name__)
    return {part: run["cpu_percent"][part] for part in PARTS}


def measured(turns: int = TURNS, seconds: float = SECONDS) -> dict[str, dict[str, float]]:
    """Without and with TLS in turns, the second half in the other order; the medians of each part."""
    runs: dict[str, list[dict[str, float]]] = {"plain": [], "tls": []}
    for turn in range(turns):
        kinds: Sequence[type[DataPath]] = (DataPath, EncryptedDataPath)
        for kind in kinds if turn % 2 == 0 else reversed(kinds):
            runs["tls" if kind.encrypted else "plain"].append(cpu_percent(kind, seconds))
    return {
        word: {part: round(statistics.median(run[part] for run in each), 2) for part in PARTS}
        for word, each in runs.items()
    }


def storing(turns: int = STORING_TURNS) -> dict[str, dict[str, float]]:
    """The same of recorder and database, in seconds."""
    runs: dict[str, list[dict[str, float]]] = {"plain": [], "tls": []}
    for turn in range(turns):
        for encrypted in (False, True) if turn % 2 == 0 else (True, False):
            runs["tls" if encrypted else "plain"].append(cpu_seconds(encrypted))
    return {
        word: {part: round(statistics.median(run[part] for run in each), 3) for part in STORING}
        for word, each in runs.items()
    }


def cost(seconds: dict[str, dict[str, float]]) -> dict[str, Any]:
    """The keys `tls_cost` and `database_tls_cost`."""
    plain, tls = seconds["plain"], seconds["tls"]
    ratios = {part: round(tls[part] / plain[part], 3) for part in plain}
    return {"ratio": round(sum(tls.values()) / sum(plain.values()), 3), "ratios": ratios, **seconds}


def compare() -> list[Comparison]:
    """Bridges and broker together, recorder and database together, with TLS against without."""
    moved = measured()
    stored = storing()
    record(RECORD, {"tls_cost": cost(moved), "database_tls_cost": cost(stored)})
    return [
        _comparison(f"bridges and broker with TLS, {VEHICLES} x 100 Hz, clouds", "% CPU", moved),
        _comparison("recorder and database with TLS, ten seconds of two vehicles", "s CPU", stored),
    ]


def _comparison(name: str, unit: str, seconds: dict[str, dict[str, float]]) -> Comparison:
    ours, baseline = (sum(seconds[word].values()) for word in ("tls", "plain"))
    return Comparison(name, unit, ours, baseline, RATIO_MAX, "the same without TLS")


def main() -> None:
    """Measure and print JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--turns", type=int, default=TURNS)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    options = parser.parse_args()
    preparing.for_tests()
    moved = cost(measured(options.turns, options.seconds))
    print(json.dumps({"tls_cost": moved, "database_tls_cost": cost(storing())}, indent=1))


if __name__ == "__main__":
    main()
