"""report.json: every metric of a run under its name, and whether the run passed."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from scenarios.definition import Scenario
from scenarios.runner.inputs import NANOSECONDS, RunInputs, TaskLife
from scenarios.runner.judging import audit, evidence, expectations, measures, naming, network
from scenarios.runner.judging.encounters import Encounter, encounters
from scenarios.runner.reporting import timeline
from scenarios.runner.reporting.series import series

PARAMETERS = (
    "vehicles",
    "lidar_vehicles",
    "pose_hz",
    "point_cloud_hz",
    "start_distance_m",
    "stop_distance_m",
    "encounters",
)
DIGITS = 6
NUMBERS_OVER_LINES = re.compile(r"\[\n\s+([^\[\]{}\"]+?)\n\s+\]")


@dataclass(frozen=True)
class Report:
    """The document of report.json, and the parts of it that are shown."""

    document: dict[str, Any]
    table: tuple[expectations.Expectation, ...]
    moments: tuple[timeline.Moment, ...]
    inputs: RunInputs

    @property
    def passed(self) -> bool:
        """Return whether every expectation holds."""
        return bool(self.document["passed"])


def report(scenario: Scenario, inputs: RunInputs) -> Report:
    """Computes the report; pure."""
    met = encounters(scenario, inputs)
    table = expectations.judge(scenario, inputs, met)
    moments = timeline.timeline(inputs, met)
    return Report(_rounded(_document(scenario, inputs, met, table, moments)), table, moments, inputs)


def write(done: Report, folder: Path, page: str) -> tuple[Path, Path]:
    """Writes report.json and report.html into `folder`, which is made; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    files = folder / "report.json", folder / "report.html"
    files[0].write_text(text(done.document))
    files[1].write_text(page)
    return files


def text(document: dict[str, Any]) -> str:
    """report.json: indented, but for lists of numbers, which take one line each."""
    indented = json.dumps(document, indent=2, allow_nan=False)
    return NUMBERS_OVER_LINES.sub(lambda numbers: f"[{' '.join(numbers[1].split())}]", indented) + "\n"


def _document(
    scenario: Scenario,
    inputs: RunInputs,
    met: Sequence[Encounter],
    table: Sequence[expectations.Expectation],
    moments: Sequence[timeline.Moment],
) -> dict[str, Any]:
    latencies = [measures.latencies(encounter) for encounter in met]
    drawings, problems = series(scenario, inputs, met)
    return (
        _story(scenario, inputs)
        | _network(inputs, met)
        | {
            "scenario": scenario.name,
            "run": inputs.run,
            "provider": inputs.provider,
            "nodes": len(scenario.nodes),
            "parameters": {name: getattr(scenario.parameters, name) for name in PARAMETERS},
            "rates_measured": {
                "pose_hz_min": measures.pose_hz_min(scenario, inputs),
                "point_cloud_hz_min": measures.point_cloud_hz_min(met),
            },
            "age_seconds": {
                "pose_p50": measures.pose_age_seconds(scenario, inputs, 0.5),
                "pose_p99": measures.pose_age_seconds(scenario, inputs, 0.99),
            },
            "latency_seconds": latencies[0] if latencies else dict.fromkeys(measures.LATENCIES),
            "latency_quantiles": {
                name: measures.quantiles(latency[name] for latency in latencies) for name in measures.LATENCIES
            },
            "latency_breakdown_seconds": [measures.breakdown(encounter) for encounter in met],
            "recorded": measures.recorded(met),
            "cpu_core_seconds": dict(sorted(inputs.cpu_core_seconds.items())),
            "set_up_seconds": dict(inputs.set_up_seconds),
            "audit": [entry.row() for entry in audit.entries(inputs)],
            "evidence": [entry.row() for entry in evidence.entries(inputs)],
            "warnings": [*_warnings(inputs), *problems],
            "expectations": [asdict(row) for row in table],
            "timeline": [_moment(inputs, moment) for moment in moments],
            "passed": all(row.passed for row in table),
            "drawings": drawings,
        }
    )


def _story(scenario: Scenario, inputs: RunInputs) -> dict[str, Any]:
    """Steps and tasks of a story that has steps; the report of one without keeps its form."""
    if not scenario.steps:
        return {}
    steps = [
        {"step": step.name, "what": step.what, "began": _since(inputs, step.began), "seen": _since(inputs, step.done)}
        for step in inputs.steps
    ]
    return {"steps": steps, "tasks": [_task(inputs, task) for task in inputs.tasks]}


def _network(inputs: RunInputs, met: Sequence[Encounter]) -> dict[str, Any]:
    """Cables, and what is missing behind them, of a run whose cables had conditions."""
    if not inputs.cables:
        return {}
    named = [[one.row() for one in naming.naming(encounter) or ()] for encounter in met]
    return {"network": network.rows(inputs.cables), "missing": named}


def _task(inputs: RunInputs, task: TaskLife) -> dict[str, Any]:
    conditions = [
        {
            "seconds": _since(inputs, condition.time),
            "condition": f"{condition.type}={condition.status}",
            "reason": condition.reason,
        }
        | {"message": condition.message}
        for condition in task.conditions
    ]
    lived = {"created": _since(inputs, task.created), "deleted": _since(inputs, task.deleted)}
    return {"task": task.key, "parent": task.parent or None, **lived, "conditions": conditions}


def _since(inputs: RunInputs, moment: int | None) -> float | None:
    return None if moment is None else (moment - inputs.started) / NANOSECONDS


def _moment(inputs: RunInputs, moment: timeline.Moment) -> dict[str, Any]:
    since = (moment.time - inputs.started) / NANOSECONDS
    return {"seconds": since, "what": moment.text, "pull_request": moment.pull_request, "commit": moment.commit}


def _warnings(inputs: RunInputs) -> list[str]:
    """Sentences that a reader must know besides the table."""
    warnings = list(inputs.warnings)
    if any("none" in commit.trailers.get("Evidence", ()) for commit in inputs.commits):
        warnings.insert(
            0, ("the release policy is `assurance: none`: charts were deployed without evidence of verification")
        )
    if inputs.input_before and inputs.input_after and inputs.input_before.started != inputs.input_after.started:
        warnings.append("the event detector was restarted during the run: its counters do not cover it")
    if inputs.broker and inputs.broker.gaps:
        warnings.append(f"the observer lost its connection to the broker {inputs.broker.gaps} times")
    warnings += [
        f"event {edge.id}: {edge.error}" for edge in inputs.edges if edge.error and edge.time >= inputs.started
    ]
    warnings += network.problems(inputs.cables)
    plans = [plan for plan in inputs.plans if plan.started is None or plan.started >= inputs.started]
    warnings += [f"plan {plan.plan}: {plan.error}" for plan in plans if plan.error]
    return warnings


def _rounded(value: Any) -> Any:
    """Cuts floats to microseconds, so that the file can be read; what is no number is not known."""
    if isinstance(value, float):
        return round(value, DIGITS) if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return [_rounded(item) for item in value] if isinstance(value, list) else value
