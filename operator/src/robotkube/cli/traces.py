"""The command `robotkube trace ID`: from an event to the pods and recordings that it led to."""

from __future__ import annotations

import argparse
from typing import Any

from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.cli.recordings import commands as cli_recordings
from robotkube.delivery.console.adapters.cluster_documents import pod_documents, release_documents
from robotkube.delivery.console.core.chains import APPLICATION, Matches, Step, View, find, steps
from robotkube.delivery.console.core.documents import plan_documents, task_document
from robotkube.delivery.console.core.moments import NS_OF_MS
from robotkube.errors import InputError, RefusalError, UnavailableError
from robotkube.foundation.documents.core.times import time_text
from robotkube.foundation.kubernetes.core.objects import object_key

Row = dict[str, Any]


def tracing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `trace`."""
    parser.add_argument("id", metavar="ID", help="of an event, a trace, a plan, or <namespace>/<name> of a task")
    parser.add_argument("--recordings", action="store_true", help="look for recordings, too; needs their database")
    cli_recordings.listing(parser)


def trace(options: argparse.Namespace) -> Table:
    """Trace an ID: one row per step, in the order of cause and effect."""
    platform = Platform(options)
    view = read_view(platform)
    matches = find(options.id, view)
    if not matches:
        raise RefusalError(
            "UnknownTrace", f"no task and no plan has to do with {options.id}; see `robotkube plan list`"
        )
    rows = [_step_row(step) for step in steps(matches, view)]
    rows += _recordings(options, matches) if options.recordings else []
    return Table("steps", ("step", "name", "time", "state"), rows)


def read_view(platform: Platform) -> View:
    """What chains are made of, as the platform has it now: the documents of the console's page."""
    return View(
        tasks={object_key(task): task_document(task) for task in platform.tasks()},
        plans=plan_documents(platform.page("/plans"), ""),
        releases=release_documents(platform.applications()),
        pods=pod_documents(platform.pods()),
    )


def _step_row(step: Step) -> Row:
    name = step.title if step.step == APPLICATION else step.id
    return _row(step.step, name, None if step.time_ms is None else time_text(step.time_ms * NS_OF_MS), step.text)


def _recordings(options: argparse.Namespace, matches: Matches) -> list[Row]:
    """The rows of recordings, whose provenance names their tasks."""
    tasks = {*matches.tasks, *(key for plan in matches.plans for key in plan["tasks"])}
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
