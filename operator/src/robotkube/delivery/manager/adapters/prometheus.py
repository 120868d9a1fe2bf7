"""The manager's metrics in Prometheus' text form: base units, labels from closed lists only.

METRICS names every one of them; docs/reference/metrics.md is made from it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from prometheus_client import CollectorRegistry, Counter, Histogram, ProcessCollector, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from robotkube.delivery.manager.core.gauges import ManagerGauges
from robotkube.delivery.manager.core.updates.states import STATES
from robotkube.delivery.manager.ports.telemetry import OUTCOMES, PlanFacts

PREFIX = "robotkube_manager_"
KINDS = ("task", "withdrawal", "initial", "update", "node", "repair", "revert")
OTHER = "other"
DECISION_SECONDS = (0.001, 0.0025, 0.005, 0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5)
MERGED_SECONDS = (0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0, 300.0)
OBSERVED_SECONDS = (0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 60.0, 300.0, 900.0)


@dataclass(frozen=True)
class Description:
    """One metric: name without PREFIX, its kind, labels with their values, and what it means."""

    name: str
    kind: str
    labels: tuple[tuple[str, str], ...]
    text: str


_TASK_LABELS = (
    ("condition", "Accepted, Committed, Synced, Ready"),
    ("status", "True, False, Unknown"),
    ("reason", "the reasons of TaskDescriptions, else Other"),
)
METRICS = (
    Description(
        "plans_total",
        "counter",
        (("kind", ", ".join((*KINDS, OTHER))), ("outcome", ", ".join(OUTCOMES))),
        "Plans by what caused them, counted at every step that they reach.",
    ),
    Description("steps_total", "counter", (), "Steps of the loop."),
    Description("step_failures_total", "counter", (), "Steps that ended early because forge or API server failed."),
    Description("decision_seconds", "histogram", (), "From what was read to the finished plan, or to none."),
    Description("merged_seconds", "histogram", (), "From the demand's being seen to its plan on main."),
    Description("observed_seconds", "histogram", (), "From a plan on main to its being observed in the cluster."),
    Description("tasks", "gauge", _TASK_LABELS, "TaskDescriptions by condition."),
    Description("tasks_waiting", "gauge", (), "Tasks that are neither on main nor refused: the queue."),
    Description("main_broken_files", "gauge", (), "Problems of release and source files on main."),
    Description("agents_unknown", "gauge", (), "Agents that have a Node and are not declared."),
    Description("holds", "gauge", (), "Agents that hold changes at the moment."),
    Description(
        "update_releases",
        "gauge",
        (("state", ", ".join(STATES)),),
        "Releases that the update of their chart is not through with, or whose results nobody measures.",
    ),
    Description("leader", "gauge", (), "1 while this process leads, 0 while it stands by."),
)


class PrometheusMetrics:
    """The port Telemetry as Prometheus metrics; `text` is the page. `read_gauges` is called at every reading of the
    page."""

    def __init__(self, read_gauges: Callable[[], ManagerGauges]) -> None:
        self._registry = CollectorRegistry()
        ProcessCollector(registry=self._registry)
        self._registry.register(_Gauges(read_gauges))
        self._plans = Counter(*_named("plans_total"), ("kind", "outcome"), registry=self._registry)
        self._steps = Counter(*_named("steps_total"), registry=self._registry)
        self._failures = Counter(*_named("step_failures_total"), registry=self._registry)
        self._decision = Histogram(*_named("decision_seconds"), registry=self._registry, buckets=DECISION_SECONDS)
        self._merged = Histogram(*_named("merged_seconds"), registry=self._registry, buckets=MERGED_SECONDS)
        self._observed = Histogram(*_named("observed_seconds"), registry=self._registry, buckets=OBSERVED_SECONDS)

    def text(self) -> str:
        """The page /metrics."""
        return generate_latest(self._registry).decode()

    def step(self, failed: bool) -> None:
        """Count a step."""
        self._steps.inc()
        if failed:
            self._failures.inc()

    def decided(self, seconds: float) -> None:
        """Observe the time of a decision."""
        self._decision.observe(seconds)

    def plan(self, plan: PlanFacts, outcome: str) -> None:
        """Count a plan's step, and observe its merge latency and the time until the cluster shows it."""
        self._plans.labels(plan.kind if plan.kind in KINDS else OTHER, outcome).inc()
        times = plan.times
        if outcome == "merged" and times.get("demand_seen"):
            self._merged.observe(max(times["merged"] - times["demand_seen"], 0) / 1e9)
        if outcome == "observed" and "merged" in times and "observed" in times:
            self._observed.observe(max(times["observed"] - times["merged"], 0) / 1e9)


class _Gauges(Collector):
    """The manager's gauges, read anew for every page."""

    def __init__(self, read_gauges: Callable[[], ManagerGauges]) -> None:
        self._read_gauges = read_gauges

    def describe(self) -> Iterable[Metric]:
        """The names of the gauges, without their values."""
        return [_gauge(metric) for metric in METRICS if metric.kind == "gauge"]

    def collect(self) -> Iterable[Metric]:
        """The gauges of this moment."""
        gauges = self._read_gauges()
        families = {metric.name: _gauge(metric) for metric in METRICS if metric.kind == "gauge"}
        for labels, count in sorted(gauges.tasks.items()):
            families["tasks"].add_metric(list(labels), count)
        for state in STATES:
            families["update_releases"].add_metric([state], gauges.updates.get(state, 0))
        values = {
            "tasks_waiting": gauges.waiting,
            "main_broken_files": gauges.broken_files,
            "agents_unknown": gauges.unknown_agents,
            "holds": gauges.holds,
            "leader": int(gauges.leading),
        }
        for name, value in values.items():
            families[name].add_metric([], value)
        return families.values()


def _gauge(description: Description) -> GaugeMetricFamily:
    return GaugeMetricFamily(
        f"{PREFIX}{description.name}", description.text, labels=[name for name, _ in description.labels]
    )


def _named(name: str) -> tuple[str, str]:
    metric = next(metric for metric in METRICS if metric.name == name)
    return f"{PREFIX}{name}", metric.text


def reference() -> str:
    """The table of docs/reference/metrics.md."""
    lines = ["| metric | kind | labels | meaning |", "| --- | --- | --- | --- |"]
    for metric in METRICS:
        labels = "; ".join(f"`{name}`: {values}" for name, values in metric.labels) or "-"
        lines.append(f"| `{PREFIX}{metric.name}` | {metric.kind} | {labels} | {metric.text} |")
    return "\n".join(lines) + "\n"
