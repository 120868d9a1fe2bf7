"""The command `robotkube task watch`: the conditions of tasks as they change, one line each."""

from __future__ import annotations

import argparse
import json
import queue
import sys
import time
from collections.abc import Iterator, Mapping
from typing import Any, TextIO

from robotkube.cli.platform import Platform
from robotkube.errors import InputError
from robotkube.foundation.documents.core.times import time_text
from robotkube.foundation.documents.core.yaml_codec import write_mapping

WATCH_SECONDS_MAX = 86_400.0
SYNC_SECONDS_MAX = 15.0
CHANGES_MAX = 10_000
COMPLAIN_SECONDS = 5.0
TIME_CHARACTERS_MAX = 27  # with microseconds; those of the cluster have none

ConditionChange = Mapping[str, str]


def watching(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `task watch`."""
    parser.add_argument("task", nargs="?", default="", metavar="TASK", help="only <namespace>/<name>; until it is gone")
    parser.add_argument("--namespace", default="", help="only tasks of this agent")
    parser.add_argument(
        "--seconds", type=float, default=3600.0, help=f"how long, at most {WATCH_SECONDS_MAX:.0f} (default: 3600)"
    )


def watch_tasks(options: argparse.Namespace) -> None:
    """Write what stands and every change to stdout until the time is over or the named task is gone. RefusalError: it
    is not there; UnavailableError: the API server does not answer at the beginning."""
    if not 0 < options.seconds <= WATCH_SECONDS_MAX:
        raise InputError(f"--seconds {options.seconds:g}: give seconds above 0, at most {WATCH_SECONDS_MAX:.0f}")
    changed: queue.Queue[tuple[str, Any, Any]] = queue.Queue(CHANGES_MAX)
    namespace = options.task.partition("/")[0] if options.task else options.namespace
    platform = Platform(options)
    if options.task:
        platform.task(options.task)
    elif not platform.tasks(namespace):
        print(f"robotkube: no task yet{f' in namespace {namespace}' if namespace else ''}", file=sys.stderr)
    watch = platform.watch_tasks(lambda *change: changed.put(change), namespace)
    watch.start()
    if not watch.synced.wait(SYNC_SECONDS_MAX):
        print(f"robotkube: {watch.complaint}", file=sys.stderr)
    end = time.monotonic() + options.seconds
    while (left := end - time.monotonic()) > 0:
        try:
            key, before, now = changed.get(timeout=min(left, COMPLAIN_SECONDS))
        except queue.Empty:
            if watch.complaint:
                print(f"robotkube: {watch.complaint}", file=sys.stderr)
            continue
        if options.task in ("", key):
            for change in changes(key, before, now, time_text(time.time_ns())):
                write_change(change, options.output, sys.stdout)
            if options.task and now is None:
                break
    watch.stop()


def changes(
    key: str, before: Mapping[str, Any] | None, now: Mapping[str, Any] | None, seen: str
) -> Iterator[ConditionChange]:
    """The conditions of a task that differ, and its coming and going, each with its time: `seen`, when it changed
    before our eyes, else when the condition got its status."""
    if now is None:
        yield {"task": key, "condition": "Withdrawn", "status": "True", "reason": "", "message": "", "time": seen}
        return
    if before is None:
        created = now["metadata"].get("creationTimestamp", "")
        yield {"task": key, "condition": "Submitted", "status": "True", "reason": "", "message": "", "time": created}
    old = _conditions(before) if before else {}
    for kind, condition in _conditions(now).items():
        if old.get(kind) != condition:
            yield {
                "task": key,
                "condition": kind,
                **{part: str(condition.get(part, "")) for part in ("status", "reason", "message")},
                "time": seen if before else str(condition.get("lastTransitionTime", "")),
            }


def _conditions(task: Mapping[str, Any]) -> Mapping[str, Mapping[str, Any]]:
    return {c["type"]: c for c in task.get("status", {}).get("conditions", [])}


def write_change(change: ConditionChange, form: str, stream: TextIO) -> None:
    """Write one change, at once: a line for people, a JSON document per line, or YAML documents."""
    if form == "json":
        stream.write(json.dumps(change, sort_keys=True) + "\n")
    elif form == "yaml":
        stream.write(f"---\n{write_mapping(dict(change))}")
    else:
        head = (
            f"{change['time'] or '-':{TIME_CHARACTERS_MAX}}  {change['task']}  {change['condition']}={change['status']}"
        )
        stream.write(f"{head}  {change['reason']}  {' '.join(change['message'].split())}".rstrip() + "\n")
    stream.flush()
