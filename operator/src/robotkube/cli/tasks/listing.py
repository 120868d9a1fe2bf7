"""The commands `robotkube task list|show|withdraw`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from typing import Any

from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.delivery.tasks.core.task_description import PRIORITY_DEFAULT
from robotkube.delivery.tasks.core.task_states import asked_for, task_state
from robotkube.foundation.kubernetes.core.objects import object_key


def listing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `task list`."""
    parser.add_argument("--namespace", default="", help="only tasks of this agent")


def naming(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of commands about one task."""
    parser.add_argument("task", help="<namespace>/<name>")


def withdrawing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `task withdraw`."""
    naming(parser)
    parser.add_argument("--dry-run", action="store_true", help="only say what would go with it, as the manager sees it")


def list_tasks(options: argparse.Namespace) -> Table:
    """List tasks, oldest first."""
    tasks = sorted(Platform(options).tasks(options.namespace), key=lambda t: t["metadata"].get("creationTimestamp", ""))
    columns = ("task", "application", "priority", "state", "reason", "plan", "pull_request")
    return Table("tasks", columns, [row(task) for task in tasks])


def row(task: Mapping[str, Any]) -> dict[str, Any]:
    """A task in one line."""
    status = task.get("status", {})
    spec = task.get("spec", {})
    return {
        "task": object_key(task),
        "application": asked_for(spec),
        "state": task_state(task),
        "reason": spec.get("reason"),
        "requester": spec.get("requester"),
        "priority": spec.get("priority", PRIORITY_DEFAULT),
        "lease_seconds": spec.get("lease", {}).get("seconds"),
        "plan": status.get("plan"),
        "pull_request": status.get("pullRequest", {}).get("number"),
        "releases": status.get("releases", []),
    }


def show_task(options: argparse.Namespace) -> Table:
    """Show the whole task, without what only Kubernetes needs."""
    task = dict(Platform(options).task(options.task))
    metadata = {k: task["metadata"][k] for k in ("namespace", "name", "creationTimestamp") if k in task["metadata"]}
    return Table("task", (), [{"metadata": metadata, "spec": task["spec"], "status": task.get("status", {})}], True)


def withdraw_task(options: argparse.Namespace) -> Table | None:
    """Delete the task; the manager's next plan removes what only it asked for. A dry run asks the manager what that
    is."""
    platform = Platform(options)
    platform.withdraw(options.task, options.dry_run)
    print(f"{'would withdraw' if options.dry_run else 'withdrawn'}: {options.task}", file=sys.stderr)
    if not options.dry_run:
        return None
    answer = dict(platform.explain({"withdraw": options.task}))
    text = "".join(f"{line}\n" for line in answer["lines"])
    return Table("withdrawal", (), [answer], single=True, text=text)
