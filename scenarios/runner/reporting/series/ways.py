"""The way of an event: what happened from the triggering pose to the first stored cloud, and from the end of the event
to the removal, step by step.

A step is critical when the goal waited for it: the first cloud in storage, and the last pod gone. Each critical step
begins where the one before it ends, and they add up to the whole. The others ran beside them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from scenarios.definition import Scenario
from scenarios.runner.inputs import NANOSECONDS, Edge, Plan, PodOfRun, RunInputs
from scenarios.runner.judging.encounters import Encounter

PODS_MAX = 6  # beside the critical one


@dataclass(frozen=True)
class Span:
    """A step from `begin` to `end` in ns; None: it was not seen."""

    step: str
    begin: int | None
    end: int | None
    critical: bool = True


def encounters(_scenario: Scenario, inputs: RunInputs, met: Sequence[Encounter]) -> list[dict[str, Any]]:
    """All encounters: who met, the edges, the moments on the way and its steps, times in s since the start."""
    return [_encounter(inputs, one) for one in met]


def _encounter(inputs: RunInputs, one: Encounter) -> dict[str, Any]:
    return {
        "event": one.start.id,
        "rule": one.start.rule,
        "agents": list(one.agents),
        "start": _edge(inputs, one.start),
        "stop": _edge(inputs, one.stop) if one.stop else None,
        "moments": [
            {"what": what, "seconds": _since(inputs, moment)} for what, moment in _moments(one) if moment is not None
        ],
        "deployment": [_row(inputs, span) for span in _deployment(one) if _seen(span)],
        "removal": [_row(inputs, span) for span in _removal(one) if _seen(span)],
    }


def _edge(inputs: RunInputs, edge: Edge) -> dict[str, Any]:
    """An event's edge, by the stamp of the pose that triggered it."""
    return {"seconds": _since(inputs, edge.stamp), "distance_m": edge.distance_m}


def _row(inputs: RunInputs, span: Span) -> dict[str, Any]:
    begin, end = _since(inputs, span.begin or 0), _since(inputs, span.end or 0)
    return {"step": span.step, "begin": begin, "end": end, "critical": span.critical}


def _since(inputs: RunInputs, moment: int) -> float:
    return (moment - inputs.started) / NANOSECONDS


def _seen(span: Span) -> bool:
    return span.begin is not None and span.end is not None and span.begin <= span.end


def _moments(one: Encounter) -> Iterator[tuple[str, int | None]]:
    plan, withdrawal, first = one.plan, one.withdrawal, one.first_cloud
    pod = _first_running(one.pods)
    yield "event", one.start.time
    yield "task created", one.start.done
    yield "deployment merged", plan.merged if plan else None
    yield "recorder runs", pod.running if pod else None
    yield "first point cloud stored", first.stored if first else None
    yield "event ends", one.stop.time if one.stop else None
    yield "removal merged", withdrawal.merged if withdrawal else None
    yield "last pod gone", one.removed


def _deployment(one: Encounter) -> Iterator[Span]:
    """The breakdown of the report, with the pose's way before it and what ran beside it."""
    plan = one.plan
    first = one.first_cloud
    pod = _first_running(one.pods)
    yield from _plan_made(one.start, plan)
    merged, running = plan.merged if plan else None, pod.running if pod else None
    created = min((other.created for other in one.pods), default=None)
    received = first.received if first else None
    yield Span("Argo CD", merged, created)
    yield Span("pod start", created, running)
    yield Span("subscription", running, received)
    yield Span("storing", received, first.stored if first else None)
    yield Span("pod ready", running, pod.ready if pod else None, False)
    for other in [other for other in one.pods if other is not pod][:PODS_MAX]:
        yield Span(f"pod {other.namespace}/{other.name}", other.created, other.running, False)
    yield Span("plan observed", merged, plan.observed if plan else None, False)


def _removal(one: Encounter) -> Iterator[Span]:
    if one.stop is None:
        return
    plan = one.withdrawal
    yield from _plan_made(one.stop, plan)
    merged = plan.merged if plan else None
    yield Span("pods going", merged, one.removed)
    yield Span("plan observed", merged, plan.observed if plan else None, False)


def _plan_made(edge: Edge, plan: Plan | None) -> Iterator[Span]:
    """The part from the triggering pose to the commit on main."""
    yield Span("pose on its way", edge.stamp, edge.time)
    yield Span("detection", edge.time, edge.done)
    yield Span("plan", edge.done, plan.proposed if plan else None)
    yield Span("gate", plan.proposed if plan else None, plan.merged if plan else None)


def _first_running(pods: Sequence[PodOfRun]) -> PodOfRun | None:
    return min((pod for pod in pods if pod.running), key=lambda pod: pod.running or 0, default=None)
