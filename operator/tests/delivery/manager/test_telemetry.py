"""What the manager says of itself: metrics with bounded labels, and plans as spans in the traces of their events."""

from __future__ import annotations

import gzip
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import ClassVar

from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.sdk.trace import ReadableSpan
from opentelemetry.sdk.trace.export import SpanExporter, SpanExportResult
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter
from opentelemetry.trace import StatusCode
from prometheus_client.parser import text_string_to_metric_families

from robotkube.delivery.manager.adapters.opentelemetry import OpenTelemetryTraces
from robotkube.delivery.manager.adapters.prometheus import METRICS, OTHER, PREFIX, PrometheusMetrics
from robotkube.delivery.manager.core.gauges import ManagerGauges
from robotkube.delivery.manager.core.placement.placement import NodeState
from robotkube.delivery.manager.loops.gauges import GaugeReader
from robotkube.delivery.manager.ports.telemetry import PlanFacts
from robotkube.foundation.runtime.adapters.prometheus_series import MetricsPage, series_text
from robotkube.foundation.runtime.ports import Series, by_one
from robotkube.testing.clusters import MemoryCluster, MemoryTasks

TIMES = {"demand_seen": 10**9, "started": 2 * 10**9, "proposed": 3 * 10**9, "merged": 4 * 10**9}
TRACES = ("a" * 32, "0" * 31 + "1")
PLAN = PlanFacts("p1", "task", "c" * 40, 7, ("cloud-0/a",), TRACES, TIMES)


def samples(text: str) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
    families = text_string_to_metric_families(text)
    return {(s.name, tuple(sorted(s.labels.items()))): s.value for family in families for s in family.samples}


def test_metrics_count_time_and_show_states() -> None:
    gauges = ManagerGauges({("Accepted", "True", "Accepted"): 3}, 2, 1, 4, 5, False, {"trial": 6})
    metrics = PrometheusMetrics(lambda: gauges)
    metrics.step(False)
    metrics.step(True)
    metrics.decided(0.004)
    metrics.plan(PLAN, "merged")
    metrics.plan(PlanFacts("p2", "a kind that nobody knows"), "refused")
    values = samples(metrics.text())
    assert values[f"{PREFIX}steps_total", ()] == 2
    assert values[f"{PREFIX}step_failures_total", ()] == 1
    assert values[f"{PREFIX}decision_seconds_bucket", (("le", "0.005"),)] == 1
    assert values[f"{PREFIX}plans_total", (("kind", "task"), ("outcome", "merged"))] == 1
    assert values[f"{PREFIX}plans_total", (("kind", OTHER), ("outcome", "refused"))] == 1
    assert values[f"{PREFIX}merged_seconds_sum", ()] == 3
    labels = (("condition", "Accepted"), ("reason", "Accepted"), ("status", "True"))
    assert values[f"{PREFIX}tasks", labels] == 3
    states = [values[PREFIX + name, ()] for name in ("tasks_waiting", "main_broken_files", "agents_unknown", "holds")]
    assert states == [2, 1, 4, 5]
    assert values[f"{PREFIX}leader", ()] == 0
    assert [values[f"{PREFIX}update_releases", (("state", one),)] for one in ("trial", "waiting")] == [6, 0]
    shown = {name for name, _ in values if name.startswith(PREFIX)}
    for one in METRICS:
        assert any(name.startswith(PREFIX + one.name) for name in shown), one.name


def test_gauges_count_by_the_closed_list_of_reasons() -> None:
    tasks = MemoryTasks()
    cluster = MemoryCluster()
    for name, accepted, committed in (
        ("waits", ("True", "Accepted"), ("False", "Proposed")),
        ("done", ("True", "Accepted"), ("True", "Merged")),
        ("refused", ("False", "NoCapableNode"), None),
        ("postponed", ("False", "Postponed"), None),
        ("strange", ("False", "x" * 500), None),
    ):
        tasks.create("cloud-0", name, {})
        states = {"Accepted": accepted, **({"Committed": committed} if committed else {})}
        conditions = [{"type": kind, "status": s, "reason": r} for kind, (s, r) in states.items()]
        tasks.objects[f"cloud-0/{name}"]["status"] = {"conditions": conditions}
    tasks.create("cloud-0", "new", {})
    cluster.machines = [NodeState(name, name, "vehicle", frozenset(), True) for name in ("known", "stranger")]
    reader = GaugeReader(tasks, cluster, lambda: {"known"}, broken=lambda: 2, leading=lambda: False)
    gauges = reader.read()
    assert gauges.tasks["Accepted", "True", "Accepted"] == 2
    assert gauges.tasks["Accepted", "False", "Other"] == 1
    assert (gauges.waiting, gauges.unknown_agents, gauges.broken_files) == (3, 1, 2)
    assert not gauges.leading


def test_a_plan_is_spans_in_the_trace_of_each_of_its_events() -> None:
    exporter = InMemorySpanExporter()
    traces = OpenTelemetryTraces("http://nowhere", "manager", exporter)
    traces.plan(PLAN, "merged")
    times = {**TIMES, "observed": 9 * 10**9}
    traces.plan(PlanFacts("p1", "task", "c" * 40, 7, ("cloud-0/a",), TRACES, times), "observed")
    traces.close()
    spans = exporter.get_finished_spans()
    assert sorted({span.context.trace_id for span in spans}) == [1, int("a" * 32, 16)]
    mine = {span.name: span for span in spans if span.context.trace_id == 1}
    assert set(mine) == {"plan", "decide", "merge", "observe"}
    assert (mine["plan"].start_time, mine["plan"].end_time) == (10**9, 9 * 10**9)
    assert (mine["observe"].start_time, mine["observe"].end_time) == (4 * 10**9, 9 * 10**9)
    assert mine["merge"].parent is not None
    assert mine["merge"].parent.span_id == mine["plan"].context.span_id
    assert mine["plan"].attributes is not None
    assert mine["plan"].attributes["robotkube.plan"] == "p1"


def test_a_plan_that_was_given_up_is_an_error_as_long_as_it_was_waited_for() -> None:
    exporter = InMemorySpanExporter()
    traces = OpenTelemetryTraces("http://nowhere", "manager", exporter)
    times = {**TIMES, "synced": 5 * 10**9, "given_up": 904 * 10**9}
    traces.plan(
        PlanFacts("p1", "task", traces=TRACES[:1], times=times, error="not observed within 900 s"), "unobserved"
    )
    traces.close()
    mine = {span.name: span for span in exporter.get_finished_spans()}
    assert mine["plan"].status.status_code == StatusCode.ERROR
    assert mine["plan"].status.description == "not observed within 900 s"
    assert mine["plan"].end_time == mine["observe"].end_time == 904 * 10**9


def test_a_refused_plan_is_an_error_and_an_odd_trace_still_a_trace() -> None:
    exporter = InMemorySpanExporter()
    traces = OpenTelemetryTraces("http://nowhere", "manager", exporter)
    traces.plan(PlanFacts("p1", "initial", traces=("20261121-100000-1a2b3c",), times=TIMES, error="no"), "refused")
    traces.close()
    [root] = [span for span in exporter.get_finished_spans() if span.name == "plan"]
    assert root.status.description == "no"
    assert root.context.trace_id != 0


class Collector(BaseHTTPRequestHandler):
    """Takes spans by OTLP over HTTP."""

    received: ClassVar[list[ExportTraceServiceRequest]] = []

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        body = gzip.decompress(body) if self.headers.get("Content-Encoding") == "gzip" else body
        self.received.append(ExportTraceServiceRequest.FromString(body))
        self.send_response(200)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        pass


def test_spans_reach_a_collector_and_one_that_is_away_costs_nothing() -> None:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Collector)
    threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True).start()
    try:
        traces = OpenTelemetryTraces(f"http://127.0.0.1:{server.server_address[1]}/v1/traces", "manager")
        traces.plan(PLAN, "refused")
        traces.close()
    finally:
        server.shutdown()
        server.server_close()
    spans = [
        span
        for request in Collector.received
        for resource in request.resource_spans
        for scope in resource.scope_spans
        for span in scope.spans
    ]
    assert {span.name for span in spans} == {"plan", "decide", "merge"}
    assert {span.trace_id.hex() for span in spans} == set(TRACES)
    away = OpenTelemetryTraces("http://127.0.0.1:1/v1/traces", "manager", gone := NoExporter())
    for _ in range(1000):  # comes back from each, although nothing that was sent has come back
        away.plan(PLAN, "refused")
    assert gone.answers == 0
    gone.known.set()
    away.close()


class NoExporter(SpanExporter):
    """A collector that is away: nobody hears of it before `known`."""

    def __init__(self) -> None:
        self.known = threading.Event()
        self.answers = 0

    def export(self, spans: Sequence[ReadableSpan]) -> SpanExportResult:
        assert self.known.wait(60), "the caller waited for the collector"
        self.answers += 1
        return SpanExportResult.FAILURE


def test_the_library_is_not_imported_while_traces_are_off() -> None:
    code = "import sys, robotkube.delivery.manager.__main__; sys.exit('opentelemetry' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0


def test_what_a_process_counts_is_read_anew_for_every_page() -> None:
    counts = {"a": 1, 'q"\\\n': 2.5}
    series = Series("own_things_total", "counter", "Things.", {}, ("kind",))
    gauge = Series("own_open", "gauge", "1 while open.", {(): 0})
    page = MetricsPage(lambda: [replace(series, values=by_one(counts))], lambda: [gauge])
    shown = samples(page.text())
    assert {name: value for name, value in shown.items() if name[0].startswith("own_")} == {
        ("own_things_total", (("kind", "a"),)): 1.0,
        ("own_things_total", (("kind", 'q"\\\n'),)): 2.5,
        ("own_open", ()): 0.0,
    }
    assert ("process_resident_memory_bytes", ()) in shown
    counts["a"] = 3
    assert samples(page.text())["own_things_total", (("kind", "a"),)] == 3.0
    assert "# TYPE own_things_total counter\n" in page.text()


def test_a_gauge_and_a_counter_of_one_stem_are_both_there() -> None:
    text = series_text(
        [
            Series("own_runs", "gauge", "Running.", {("queued",): 2}, ("status",)),
            Series("own_runs_total", "counter", "Ended.", {("images", "passed"): 1}, ("suite", "outcome")),
        ]
    )
    assert text.splitlines() == [
        "# HELP own_runs Running.",
        "# TYPE own_runs gauge",
        'own_runs{status="queued"} 2.0',
        "# HELP own_runs_total Ended.",
        "# TYPE own_runs_total counter",
        'own_runs_total{outcome="passed",suite="images"} 1.0',
    ]
