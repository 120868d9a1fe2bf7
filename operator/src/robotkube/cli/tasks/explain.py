"""The command `robotkube task explain`: a decision in words, and what it changes in the deployment repository."""

from __future__ import annotations

import argparse
import difflib
import time
from collections.abc import Iterator, Mapping
from typing import Any

from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.cli.tasks.submit import described, describing
from robotkube.errors import InputError


def explaining(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `task explain`."""
    parser.add_argument("task", nargs="?", metavar="TASK", help="<namespace>/<name> of a task that is there")
    describing(parser)
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="also what would change in the deployment repository (implied without TASK)",
    )


def explain_task(options: argparse.Namespace) -> Table:
    """Explain what was decided about a task, or would be; refused when it would be refused."""
    platform = Platform(options)
    new = options.file or options.application or options.provides
    if bool(options.task) == bool(new):
        raise InputError("name a task that is there, or describe a new one by -f FILE or --application; not both")
    if options.task:
        task = platform.task(options.task)
        answer = {**platform.explain({"task": options.task}), "status": task.get("status", {})}
    else:
        answer = dict(platform.explain(described(options, time.time_ns())))
    text = "".join(f"{line}\n" for line in words(answer, bool(new) or options.dry_run))
    refusal = f"{answer['reason']}: {answer['message']}" if answer["outcome"] == "Refused" else ""
    return Table("explanation", (), [answer], single=True, refusal=refusal, text=text)


def words(answer: Mapping[str, Any], with_changes: bool) -> Iterator[str]:
    """The explanation for people."""
    for condition in answer.get("status", {}).get("conditions", []):
        yield f"{condition['type']}={condition['status']} {condition['reason']}: {condition['message']}"
    for entry in answer.get("status", {}).get("history", []):
        yield f"{entry['time']} {entry['reason']} (generation {entry['generation']}): {entry['message']}"
    yield from answer["lines"]
    if with_changes:
        for change in answer["changes"]:
            yield ""
            yield from _difference(change)


def _difference(change: Mapping[str, Any]) -> Iterator[str]:
    before = (change["before"] or "").splitlines()
    after = (change["after"] or "").splitlines()
    path = change["path"]
    old = "/dev/null" if change["before"] is None else f"a/{path}"
    new = "/dev/null" if change["after"] is None else f"b/{path}"
    yield from difflib.unified_diff(before, after, old, new, lineterm="")
