"""Plans as OpenTelemetry traces, sent by OTLP over HTTP: the trace id is that of the event that asked.

    plan                    from the demand's arrival to its observation (or to the end of the plan)
      decide                from the beginning of the planning to the proposal
      merge                 from the proposal to main
      observe               from main to the cluster, or to the moment when nobody waits for it any more

A plan that answers several events stands in the trace of each of them. Import this module only when traces are wanted:
the library costs 0.2 s of start.
"""

from __future__ import annotations

import secrets
from collections.abc import Mapping

from opentelemetry import trace
from opentelemetry.context import Context
from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import Resource
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor, SpanExporter
from opentelemetry.trace import NonRecordingSpan, SpanContext, Status, StatusCode, TraceFlags

from robotkube.delivery.manager.ports.telemetry import PlanFacts

EXPORT_SECONDS_MAX = 5
TRACES_MAX = 100
ENDS = frozenset({"observed", "unobserved", "refused", "outdated", "superseded"})
STAGES = (
    ("decide", "started", "proposed"),
    ("merge", "proposed", "merged"),
    ("observe", "merged", "observed"),
    ("observe", "merged", "given_up"),
)


class OpenTelemetryTraces:
    """The port Telemetry as traces. `endpoint` is the collector's address (`http://collector:4318/v1/traces`). Spans
    wait in a bounded queue and are sent from a thread of its own: a collector that is away costs the manager
    nothing."""

    def __init__(self, endpoint: str, manager: str, exporter: SpanExporter | None = None) -> None:
        resource = Resource.create({"service.name": "robotkube-manager", "service.instance.id": manager})
        self._provider = TracerProvider(resource=resource)
        sender = exporter or OTLPSpanExporter(endpoint, timeout=EXPORT_SECONDS_MAX)
        self._provider.add_span_processor(BatchSpanProcessor(sender))
        self._tracer = self._provider.get_tracer("robotkube")

    def step(self, failed: bool) -> None:
        """Ignore steps: they are no spans."""

    def decided(self, seconds: float) -> None:
        """Ignore decisions: they stand in the traces of their plans."""

    def plan(self, plan: PlanFacts, outcome: str) -> None:
        """Write the spans of a plan that has ended."""
        if outcome in ENDS and plan.times:
            for identifier in list(dict.fromkeys(plan.traces))[:TRACES_MAX]:
                self._write(identifier, plan, outcome)

    def close(self) -> None:
        """Send the spans that wait."""
        self._provider.shutdown()

    def _write(self, identifier: str, plan: PlanFacts, outcome: str) -> None:
        times = plan.times
        begin = times.get("demand_seen") or min(times.values())
        end = max(times.values())
        root = self._tracer.start_span("plan", _event(identifier), attributes=_attributes(plan), start_time=begin)
        root.set_attribute("robotkube.outcome", outcome)
        if outcome != "observed":
            root.set_status(Status(StatusCode.ERROR, plan.error))
        inside = trace.set_span_in_context(root)
        for name, first, last in STAGES:
            if first in times and last in times:
                self._tracer.start_span(name, inside, start_time=times[first]).end(times[last])
        root.end(end)


def _event(identifier: str) -> Context:
    """The context of the event: its trace, and a span that nobody wrote down."""
    number = int(identifier, 16) if len(identifier) == 32 and _is_hex(identifier) else hash_of(identifier)
    context = SpanContext(number, secrets.randbits(64) or 1, is_remote=True, trace_flags=TraceFlags(TraceFlags.SAMPLED))
    return trace.set_span_in_context(NonRecordingSpan(context))


def _is_hex(text: str) -> bool:
    return all(digit in "0123456789abcdef" for digit in text) and int(text, 16) != 0


def hash_of(text: str) -> int:
    """A trace id for what has none of 32 digits, such as a plan's id: its bytes, right-aligned."""
    return int.from_bytes(text.encode()[-16:], "big") or 1


def _attributes(plan: PlanFacts) -> Mapping[str, str | int | tuple[str, ...]]:
    attributes: dict[str, str | int | tuple[str, ...]] = {
        "robotkube.plan": plan.id,
        "robotkube.kind": plan.kind,
        "robotkube.commit": plan.commit,
        "robotkube.tasks": plan.tasks,
    }
    return attributes if plan.pull_request is None else {**attributes, "robotkube.pull_request": plan.pull_request}
