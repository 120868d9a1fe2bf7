"""The commands `robotkube plan list` and `robotkube release list`."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from typing import Any

from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.delivery.manager.adapters.kubernetes_cluster import read_application
from robotkube.delivery.manager.adapters.pod_states import read_pod
from robotkube.errors import RobotKubeError
from robotkube.foundation.kubernetes.core.objects import is_withdrawn, object_key


def list_plans(options: argparse.Namespace) -> Table:
    """List the manager's plans, oldest first; times are seconds since the demand was seen."""
    rows = [{**plan, **_seconds(plan)} for plan in Platform(options).page("/plans")["plans"]]
    columns = ("plan", "subject", "pull_request", "merged_seconds", "observed_seconds", "error")
    return Table("plans", columns, rows)


def _seconds(plan: Mapping[str, Any]) -> dict[str, float | None]:
    begin = plan.get("demand_seen")
    steps = ("proposed", "merged", "synced", "observed")
    return {f"{s}_seconds": round((plan[s] - begin) / 1e9, 2) if begin and plan.get(s) else None for s in steps}


def list_releases(options: argparse.Namespace) -> Table:
    """List the releases' Argo CD Applications with the plan that wrote them, the tasks that demand them (none: the
    initial configuration), the nodes of their pods, and what an update of their chart does with them."""
    platform = Platform(options)
    rows = []
    demands = _demands(platform.tasks())
    nodes = _nodes(platform.pods())
    updates = _updates(platform)
    for item in platform.applications():
        application = read_application(item)
        key = f"{item['spec']['destination']['namespace']}/{_release_name(item)}"
        rows.append(
            {
                "release": key,
                "demands": demands.get(key, []),
                "nodes": sorted(nodes.get(key, ())),
                "chart": application.source.get("repoURL", "").rpartition("/")[2],
                "digest": str(application.source.get("targetRevision", "")),
                "plan": application.plan,
                "sync": application.sync,
                "health": application.health,
                "update": updates.get(key, ""),
                "messages": list(application.conditions),
            }
        )
    return Table(
        "releases",
        ("release", "chart", "digest", "plan", "sync", "health", "nodes", "demands", "update", "messages"),
        sorted(rows, key=lambda row: str(row["release"])),
    )


def _updates(platform: Platform) -> dict[str, str]:
    """The state of each release that an update is not through with, and why; none where the manager's pages may not be
    read or do not answer: the rest is the cluster's."""
    try:
        releases = platform.page("/updates")["releases"]
    except RobotKubeError:
        return {}
    return {key: f"{one['state']}: {one['text']}" for key, one in releases.items()}


def _demands(tasks: Iterable[Mapping[str, Any]]) -> dict[str, list[str]]:
    """The tasks that each release answers, as their statuses say."""
    demands: dict[str, list[str]] = {}
    for task in tasks:
        for release in task.get("status", {}).get("releases", []) if not is_withdrawn(task) else []:
            demands.setdefault(release, []).append(object_key(task))
    return demands


def _nodes(pods: Iterable[Mapping[str, Any]]) -> dict[str, set[str]]:
    """The nodes that each release's pods are on."""
    nodes: dict[str, set[str]] = {}
    for pod in map(read_pod, pods):
        nodes.setdefault(pod.release, set()).update([pod.node] if pod.node else [])
    return nodes


def _release_name(item: Mapping[str, Any]) -> str:
    name = item["spec"].get("source", {}).get("helm", {}).get("releaseName")
    return str(name or item["metadata"]["name"])
