"""`robotkube plan list`, `robotkube release list`."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from robotkube.adapters.kubernetes_api import read_application
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
    """Argo CD Applications of the releases with the plan that wrote them."""
    rows = []
    for item in Platform(options).applications():
        application = read_application(item)
        rows.append(
            {
                "release": f"{item['spec']['destination']['namespace']}/{_release_name(item)}",
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
        ("release", "chart", "digest", "plan", "sync", "health", "messages"),
        sorted(rows, key=lambda row: str(row["release"])),
    )


def _release_name(item: Mapping[str, Any]) -> str:
    name = item["spec"].get("source", {}).get("helm", {}).get("releaseName")
    return str(name or item["metadata"]["name"])
