"""From an event to the first point cloud stored, in the use case with ten encounters on a cluster of its own, and where
the time goes. To build/bench/event-detector.json. Needs the machine for itself, as `publication` does.
"""

from __future__ import annotations

import json
import statistics
import sys
from typing import Any

from benchmarks.detector.event_detector import RECORD
from benchmarks.measuring.comparisons import Comparison, record
from benchmarks.platform.publication import CLUSTER, SCENARIO
from ci.cluster import choosing
from ci.errors import SetUpError
from scenarios import demo
from scenarios.runner.running import REPORTS

VARIANT = "ten-encounters"
MUST_SECONDS = 6.0
KEY = "event_to_first_point_cloud_stored"


def compare() -> list[Comparison]:
    """The p95 against what it must be."""
    report = run()
    latency = report["latency_quantiles"][KEY]
    if latency["p95"] is None:
        raise SetUpError("the report knows no first cloud of any encounter")
    values = {
        "event_to_first_cloud_p95_s": round(latency["p95"], 3),
        "event_to_first_cloud_p50_s": round(latency["p50"], 3),
        "event_to_first_cloud_n": latency["n"],
        "event_to_first_cloud_breakdown_s": medians(report["latency_breakdown_seconds"]),
        "detection_p95_s": report["latency_quantiles"]["detection"]["p95"],
    }
    record(RECORD, values)
    return [
        Comparison(
            f"event to first cloud, p95 of {latency['n']}", "s", latency["p95"], MUST_SECONDS, 1.0, "what it must be"
        )
    ]


def medians(breakdowns: list[dict[str, float | None]]) -> dict[str, float]:
    """Part -> the median over the encounters in which it is known, in s."""
    parts = {name: [breakdown[name] for breakdown in breakdowns] for name in breakdowns[0]}
    known = {name: [value for value in values if value is not None] for name, values in parts.items()}
    return {name: round(statistics.median(values), 3) for name, values in known.items() if values}


def run() -> dict[str, Any]:
    """The report of the scenario on a new cluster. What the scenario itself expects is told by its own table."""
    choosing.remove_running(lambda text: print(text, file=sys.stderr))
    try:
        demo.run(demo.Request(SCENARIO, {}, CLUSTER, "scenario", variant=VARIANT))
    finally:
        choosing.provider(CLUSTER).down()
    file = REPORTS / SCENARIO.name / "report.json"
    report: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return report
