"""`make bench`: every benchmark, as ratios against a baseline that is measured in the same run.

    python -m benchmarks [--only planning] [--against REVISION]

Prints a table and writes build/reports/benchmarks.json; what registry and gate cost in seconds goes to
build/bench/registry.json, what the manager costs to build/bench/application-manager.json, what event detector and
bridge cost to build/bench/event-detector.json, what admission adds to build/bench/admission.json, what links and their
rights take to build/bench/links.json, what a browser sees of the console to build/bench/console.json. Exit code 1 when
a ratio is beyond its bound. What a benchmark needs (tool chain; images, for those on a cluster) is made before its time
begins, and cached.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial

from benchmarks import files
from benchmarks.bridges import narrow_uplink, processor_time
from benchmarks.broker import encryption, links, rights
from benchmarks.delivery import application_manager, console, gate, planning
from benchmarks.detector import event_detector
from benchmarks.measuring.comparisons import Comparison
from benchmarks.platform import applying, encounters, publication
from benchmarks.registry import admission, catalogue
from ci.errors import SetUpError
from ci.folders import PROJECT
from ci.test import preparing

REPORT = PROJECT / "build" / "reports" / "benchmarks.json"
BENCHMARKS: dict[str, Callable[[], list[Comparison]]] = {
    "planning": planning.compare,
    "files": files.compare,
    "bridging": processor_time.compare,
    "encryption": encryption.compare,
    "event-detector": event_detector.compare,
    "narrow-uplink": narrow_uplink.compare,
    "links": links.compare,
    "rights": rights.compare,
    "console": console.compare,
    "registry": catalogue.compare,
    "gate": gate.compare,
    "admission": admission.compare,
    "application-manager": application_manager.compare,
    "publication": publication.compare,
    "application-manager-cluster": applying.compare,
    "encounters": encounters.compare,
}
NEED_IMAGES = frozenset({"publication", "application-manager-cluster", "encounters"})


def row(one: Comparison) -> str:
    """One line of the table."""
    values = f"{one.ours:>9.2f} {one.baseline:>9.2f} {one.unit:<6} {one.ratio:>6.2f} {one.ratio_max:>6.2f}"
    return f"{one.name:<48} {values}  {'ok' if one.passed else 'FAILED'}  ({one.baseline_is})"


def main() -> int:
    parser = argparse.ArgumentParser(prog="make bench", description=__doc__)
    parser.add_argument("--only", action="append", choices=sorted(BENCHMARKS), help="run only this one")
    parser.add_argument("--against", default="", help="the revision whose decisions are measured in the same run")
    arguments = parser.parse_args()
    chosen = arguments.only or list(BENCHMARKS)
    benchmarks = BENCHMARKS | {"application-manager": partial(application_manager.compare, arguments.against)}
    comparisons: list[Comparison] = []
    try:
        preparing.prepare("toolchain" if NEED_IMAGES.isdisjoint(chosen) else "images")
        if "console" in chosen:
            console.prepare()
        print(f"{'':<48} {'ours':>9} {'baseline':>9} {'':<6} {'ratio':>6} {'at most':>6}", flush=True)
        for name in chosen:
            began = time.monotonic()
            for comparison in benchmarks[name]():
                comparisons.append(comparison)
                print(row(comparison), flush=True)
            print(f"{name}: {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
    except SetUpError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    REPORT.parent.mkdir(parents=True, exist_ok=True)
    document = [asdict(one) | {"ratio": round(one.ratio, 3), "passed": one.passed} for one in comparisons]
    REPORT.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    passed = sum(one.passed for one in comparisons)
    print(f"{REPORT.relative_to(PROJECT)}: {passed} of {len(comparisons)} within their bounds")
    return 0 if passed == len(comparisons) else 1


if __name__ == "__main__":
    sys.exit(main())
