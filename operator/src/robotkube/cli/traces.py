"""The command `robotkube trace ID`: from an event to the pods and recordings that it led to."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.cli.recordings import commands as cli_recordings
from robotkube.cli.tasks.listing import state
from robotkube.delivery.deployment.core.releases import application_name
from robotkube.delivery.manager.adapters.kubernetes_cluster import read_application
from robotkube.delivery.manager.adapters.pod_states import read_pod
from robotkube.errors import InputError, RefusalError, UnavailableError
from robotkube.foundation.kubernetes.core.objects import object_key

Object = Mapping[str, Any]
Row = dict[str, Any]


def tracing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `trace`."""
    parser.add_argument("id", metavar="ID", help="of an event, a trace, a plan, or <namespace>/<name> of a task")
    parser.add_argument("--recordings", action="store_true", help="look for recordings, too; needs their database")
    cli_recordings.listing(parser)


@dataclass
class TraceMatches:
    """The tasks, plans and releases (by key) that belong to one ID."""

    tasks: list[Object] = field(default_factory=list)
    plans: list[Object] = field(default_factory=list)
    releases: list[str] = field(default_factory=list)


def trace(options: argparse.Namespace) -> Table:
    """Trace an ID: one row per step, in the order of cause and effect."""
    platform = Platform(options)
    matches = find(options.id, platform.tasks(), platform.page("/plans")["plans"])
    if not matches.tasks and not matches.plans:
        raise RefusalError(
            "UnknownTrace", f"no task and no plan has to do with {options.id}; see `robotkube plan list`"
        )
    applications = {item["metadata"]["name"]: item for item in platform.applications()}
    rows = [*_causes(matches), *_effects(matches, applications, platform.pods())]
    rows += _recordings(options, matches) if options.recordings else []
    return Table("steps", ("step", "name", "time", "state"), rows)


def find(wanted: str, tasks: Sequence[Object], plans: Sequence[Object]) -> TraceMatches:
    """The tasks and plans that name `wanted` (of an event, a trace, a plan or a task)."""
    named = [task for task in tasks if wanted in _names(task)]
    keys = {wanted, *(object_key(task) for task in named), *(task.get("status", {}).get("plan", "") for task in named)}
    keys.discard("")
    chosen = [plan for plan in plans if keys & {plan["plan"], *plan["tasks"], *plan["events"], *plan.get("traces", ())}]
    releases = {key for task in named for key in task.get("status", {}).get("releases", [])}
    releases |= {key for plan in chosen for word in ("created", "changed") for key in plan[word]}
    return TraceMatches(named, chosen, sorted(releases))


def _names(task: Object) -> set[str]:
    event = task.get("spec", {}).get("event", {})
    status = task.get("status", {})
    return {object_key(task), event.get("id", ""), event.get("trace", ""), status.get("plan", "")} - {""}


def _causes(matches: TraceMatches) -> Iterator[Row]:
    for task in matches.tasks:
        event = task["spec"].get("event", {})
        yield _row(
            "event", event.get("id"), event.get("time"), f"{event.get('rule')}: {task['spec'].get('reason', '')}"
        )
        yield _row("task", object_key(task), task["metadata"].get("creationTimestamp"), state(task))
    known = {object_key(task) for task in matches.tasks}
    for name in sorted({name for plan in matches.plans for name in plan["tasks"]} - known):
        yield _row("task", name, None, "withdrawn, or another's of the same plan")
    for plan in matches.plans:
        outcome = "on main" if plan["on_main"] else plan["error"] or "proposed"
        yield _row("plan", plan["plan"], _time(plan.get("started")), plan["subject"])
        if plan["pull_request"] is not None:
            yield _row("pull request", f"{plan['pull_request']}", _time(plan.get("proposed")), plan.get("url") or "")
        if plan["commit"]:
            yield _row("commit", plan["commit"], _time(plan.get("merged")), outcome)


def _effects(matches: TraceMatches, applications: Mapping[str, Object], pods: Sequence[Object]) -> Iterator[Row]:
    by_release: dict[str, list[Object]] = {}
    for pod in pods:
        by_release.setdefault(read_pod(pod).release, []).append(pod)
    for key in matches.releases:
        name = application_name(*key.split("/"))
        item = applications.get(name)
        application = read_application(item) if item else None
        words = f"{application.sync} {application.health} plan {application.plan}" if application else "not there"
        yield _row("Application", name, None, words)
        for pod in by_release.get(key, []):
            place = f"{pod.get('status', {}).get('phase', '')} on {pod.get('spec', {}).get('nodeName', 'no node')}"
            yield _row("pod", object_key(pod), pod.get("status", {}).get("startTime"), place)


def _recordings(options: argparse.Namespace, matches: TraceMatches) -> list[Row]:
    """The rows of recordings, whose provenance names their tasks."""
    tasks = {*map(object_key, matches.tasks), *(key for plan in matches.plans for key in plan["tasks"])}
    try:
        rows = cli_recordings.list_all(options).rows
    except (InputError, UnavailableError) as error:
        return [_row("recording", None, None, f"not known: {error}")]
    return [
        _row("recording", r["recording"], r["started"], f"{r['state']} by {r['agent']}")
        for r in rows
        if r["task"] in tasks
    ]


def _row(step: str, name: Any, time: Any, words: str) -> Row:
    return {"step": step, "name": name, "time": time, "state": words}


def _time(nanoseconds: int | None) -> str | None:
    return None if nanoseconds is None else f"{datetime.fromtimestamp(nanoseconds / 1e9, UTC):%Y-%m-%dT%H:%M:%S.%f}Z"
