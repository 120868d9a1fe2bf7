"""The platform's chart as it was at an earlier commit, and what an upgrade from it has to change."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from ci.folders import PROJECT
from tests.stages.platform.running_platform import Platform

# The chart links to the first files of the repositories.
CHART = "charts/robotkube"
SEEDS = ("gitops", "registry/policies")
COLUMN = "Ready"  # of the definition of tasks, which the older charts are made to lack
TASKS = "taskdescriptions.robotkube.io"
DEFINITIONS = (TASKS, "inspections.robotkube.io")


@dataclass(frozen=True)
class Older:
    """A commit whose chart runs with the images of today, and whether the broker's pod is another one in today's."""

    commit: str
    broker_restarts: bool


# The last version of the CHANGELOG, 0.1.0, is no such chart: today's bootstrap, manager and suite-runner refuse its
# settings (`registry` and `rooms` are unknown keys; `oci_registry`, `test_namespaces` and `argocd.hook_readers` are
# missing). The oldest on main whose settings all processes read is the latter of these, where broker and database have
# come to speak TLS; gate, managers and forge speak HTTP in both.
WAYS = {
    "broker stays": Older("aed7bbe2743869f7df8c0b597ea62efe2c86417e", broker_restarts=False),
    "broker restarts": Older("878855eb0663bb3dbff321c4f6729c31f3bd0355", broker_restarts=True),
}
# As UPGRADING.md says it for who renders without a cluster; a platform that is there keeps passwords by itself as well.
# Changing over takes up to two minutes until kubelets have brought certificates; bridges keep poses for 60 s.
PRESENT_VALUES: Mapping[str, Any] = {"tls": {"accounts": "passwords"}}


def older_chart(folder: Path, commit: str = "HEAD~1") -> Path:
    """The chart of a commit, with a definition of tasks that lacks a column; skips where that is not to be had."""

    def git(*arguments: str) -> subprocess.CompletedProcess[bytes]:
        return subprocess.run(["git", *arguments], cwd=PROJECT, capture_output=True, check=False, timeout=60)

    if git("cat-file", "-e", f"{commit}^{{commit}}").returncode:
        pytest.skip(f"the chart of {commit} is in the Git history, which is not here")
    archived = git("archive", commit, CHART, *SEEDS)
    assert archived.returncode == 0, archived.stderr.decode()
    subprocess.run(["tar", "--extract", "--directory", folder], input=archived.stdout, check=True, timeout=60)
    definition_file = folder / CHART / "templates" / "taskdescriptions" / "customresourcedefinition.yaml"
    lines = definition_file.read_text().splitlines(keepends=True)
    kept = [line for line in lines if f"- {{name: {COLUMN}," not in line]
    assert len(kept) == len(lines) - 1
    definition_file.write_text("".join(kept))
    return folder / CHART


def columns(platform: Platform) -> list[str]:
    """The columns that `kubectl get tasks` shows."""
    definition = platform.get("customresourcedefinition", TASKS)
    return [column["name"] for column in definition["spec"]["versions"][0]["additionalPrinterColumns"]]


def versions(objects: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Names and versions, with schemas and columns, of the definitions among these objects."""
    return {
        one["metadata"]["name"]: one["spec"]["versions"] for one in objects if one["metadata"]["name"] in DEFINITIONS
    }
