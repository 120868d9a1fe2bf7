"""`robotkube plan list`, `robotkube release list`."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from typing import Any

from robotkube.adapters.kubernetes_api import read_application, read_pod
from robotkube.domain.tasks import is_withdrawn, object_key
from robotkube.entrypoints.cli_output import Table
from robotkube.entrypoints.cli_platform import Platform


def list_plans(options: argparse.Namespace) -> Table:
    """Plans of the manager, oldest first; times are seconds since the demand was seen."""
    rows = [{**plan, **_seconds(plan)} for plan in Platform(options).page("/plans")["plans"]]
    columns = ("plan", "subject", "pull_request", "merged_seconds", "observed_seconds", "error")
    return Table("plans", columns, rows)


def _seconds(plan: Mapping[str, Any]) -> dict[str, float | None]:
    begin = plan.get("demand_seen")
    steps = ("proposed", "merged", "synced", "observed")
    return {f"{s}_seconds": round((plan[s] - begin) / 1e9, 2) if begin and plan.get(s) else None for s in steps}


def list_releases(options: argparse.Namespace) -> Table:
    """Argo CD Applications of the releases with the plan that wrote them, the tasks that demand them (none: the initial
    configuration), and the nodes of their pods."""
    platform, rows = Platform(options), []
    demands, nodes = _demands(platform.tasks()), _nodes(platform.pods())
    for item in platform.applications():
        application = read_application(item)
        key = f"{item['spec']['destination']['namespace']}/{_release_name(item)}"
        rows.append(
            {
                "release": key,
                "demands": demands.get(key, []),
                "nodes": sorted(nodes.get(key, ())),
                "chart": application.source.get("repoURL", "").rpartition("/")[2],
                "digest": str(application.source.get("targetRevision", ""))[:19],
                "plan": application.plan,
                "sync": application.sync,
                "health": application.health,
                "messages": list(application.conditions),
            }
        )
    return Table(
        "releases",
        ("release", "chart", "digest", "plan", "sync", "health", "nodes", "demands", "messages"),
        sorted(rows, key=lambda row: str(row["release"])),
    )


def _demands(tasks: Iterable[Mapping[str, Any]]) -> dict[str, list[str]]:
    """Release -> tasks that it answers, as their statuses say."""
    found: dict[str, list[str]] = {}
    for task in tasks:
        for release in task.get("status", {}).get("releases", []) if not is_withdrawn(task) else []:
            found.setdefault(release, []).append(object_key(task))
    return found


def _nodes(pods: Iterable[Mapping[str, Any]]) -> dict[str, set[str]]:
    """Release -> nodes that its pods are on."""
    found: dict[str, set[str]] = {}
    for pod in map(read_pod, pods):
        found.setdefault(pod.release, set()).update([pod.node] if pod.node else [])
    return found


def _release_name(item: Mapping[str, Any]) -> str:
    name = item["spec"].get("source", {}).get("helm", {}).get("releaseName")
    return str(name or item["metadata"]["name"])
