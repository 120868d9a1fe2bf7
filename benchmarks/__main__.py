"""`make bench`: every benchmark, as ratios against a baseline that is measured in the same run.

    python -m benchmarks [--only planning] [--against REVISION]

Prints a table and writes build/reports/benchmarks.json; what registry and gate cost in seconds goes to
build/bench/registry.json, what the manager costs to build/bench/application-manager.json, what event detector and
bridge cost to build/bench/event-detector.json. Exit code 1 when a ratio is beyond its bound. What a benchmark needs
(tool chain; images, for those on a cluster) is made before its time begins, and cached.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial

from benchmarks import (
    application_manager,
    application_manager_cluster,
    bridging,
    encounters,
    event_detector,
    files,
    gate,
    planning,
    publication,
    registry,
)
from benchmarks.measuring import Figure
from ci import preparing
from ci.errors import SetUpError
from ci.folders import PROJECT

REPORT = PROJECT / "build" / "reports" / "benchmarks.json"
BENCHMARKS: dict[str, Callable[[], list[Figure]]] = {
    "planning": planning.figures,
    "files": files.figures,
    "bridging": bridging.figures,
    "event-detector": event_detector.figures,
    "registry": registry.figures,
    "gate": gate.figures,
    "application-manager": application_manager.figures,
    "publication": publication.figures,
    "application-manager-cluster": application_manager_cluster.figures,
    "encounters": encounters.figures,
}
NEED_IMAGES = frozenset({"publication", "application-manager-cluster", "encounters"})


def row(figure: Figure) -> str:
    """One line of the table."""
    values = (
        f"{figure.ours:>9.2f} {figure.baseline:>9.2f} {figure.unit:<6} {figure.ratio:>6.2f} {figure.ratio_max:>6.2f}"
    )
    return f"{figure.name:<48} {values}  {'ok' if figure.passed else 'FAILED'}  ({figure.baseline_is})"


def main() -> int:
    parser = argparse.ArgumentParser(prog="make bench", description=__doc__)
    parser.add_argument("--only", action="append", choices=sorted(BENCHMARKS), help="run only this one")
    parser.add_argument("--against", default="", help="the revision whose decisions are measured in the same run")
    arguments = parser.parse_args()
    chosen = arguments.only or list(BENCHMARKS)
    benchmarks = BENCHMARKS | {"application-manager": partial(application_manager.figures, arguments.against)}
    found: list[Figure] = []
    try:
        preparing.prepare("toolchain" if NEED_IMAGES.isdisjoint(chosen) else "images")
        print(f"{'':<48} {'ours':>9} {'baseline':>9} {'':<6} {'ratio':>6} {'at most':>6}", flush=True)
        for name in chosen:
            began = time.monotonic()
            for figure in benchmarks[name]():
                found.append(figure)
                print(row(figure), flush=True)
            print(f"{name}: {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
    except SetUpError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    REPORT.parent.mkdir(parents=True, exist_ok=True)
    document = [asdict(figure) | {"ratio": round(figure.ratio, 3), "passed": figure.passed} for figure in found]
    REPORT.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    print(f"{REPORT.relative_to(PROJECT)}: {sum(one.passed for one in found)} of {len(found)} within their bounds")
    return 0 if all(one.passed for one in found) else 1


if __name__ == "__main__":
    sys.exit(main())
