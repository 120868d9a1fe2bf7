"""`robotkube registry try` on a cluster: the suites that need one run in namespaces of the command's own, which are
gone afterwards, also after an interruption, and after a kill with the next run."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from ci.folders import PROJECT
from tests.stages.platform.running_platform import Platform, eventually
from tests.stages.programs import program
from tests.stages.registry.publications import write_sources

pytestmark = pytest.mark.thorough

NAME = "try-greeter"
CHART = f"charts/apps/{NAME}"
SECONDS_MAX = 120.0  # demanded, without soak
COMMAND_SECONDS_MAX = 300


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A chart as `registry new` writes it, on the platform's own image."""
    folder = tmp_path_factory.mktemp("sources")
    write_sources(folder, NAME)
    return folder


@contextlib.contextmanager
def trying(platform: Platform, sources: Path) -> Iterator[subprocess.Popen[str]]:
    """The command while it runs."""
    variables = {"KUBECONFIG": str(platform.installer.kubeconfig), "ROBOTKUBE_HELM": program("helm")}
    words = [str(PROJECT / "ci" / "python"), "-m", "robotkube.cli", "registry", "try", CHART, "-o", "json"]
    process = subprocess.Popen(
        words,
        cwd=sources,
        env={**os.environ, **variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def own_namespaces(platform: Platform) -> Sequence[str]:
    items = platform.get("namespaces", "-l", "robotkube.io/try")["items"]
    return [item["metadata"]["name"] for item in items]


def test_interface_and_install_run_where_a_cluster_is(platform: Platform, sources: Path) -> None:
    began = time.monotonic()
    with trying(platform, sources) as process:
        out, error = process.communicate(timeout=COMMAND_SECONDS_MAX)
    seconds = time.monotonic() - began
    assert process.returncode == 0, f"{out[-3000:]}\n{error[-3000:]}"
    rows = {row["suite"]: row for row in json.loads(out)["suites"]}
    assert {name: row["outcome"] for name, row in rows.items()} == {
        "static": "passed",
        "images": "passed",
        "interface": "passed",
        "install": "passed",
    }, out
    assert seconds <= SECONDS_MAX
    assert own_namespaces(platform) == []


def test_an_interrupted_one_takes_its_namespaces_along(platform: Platform, sources: Path) -> None:
    with trying(platform, sources) as process:
        eventually("a namespace is there", lambda: own_namespaces(platform), seconds=60)
        os.killpg(process.pid, signal.SIGINT)
        process.communicate(timeout=60)
    assert process.returncode == 1
    eventually("the namespaces are gone", lambda: not own_namespaces(platform), seconds=60)


def test_what_a_killed_one_leaves_the_next_one_removes(platform: Platform, sources: Path) -> None:
    with trying(platform, sources) as process:
        eventually("a namespace is there", lambda: own_namespaces(platform), seconds=60)
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate(timeout=60)
    left = set(own_namespaces(platform))
    assert left
    with trying(platform, sources) as process:
        _, error = process.communicate(timeout=COMMAND_SECONDS_MAX)
    assert process.returncode == 0, error
    assert "removed what an earlier try left behind: namespace robotkube-try-" in error
    eventually("the namespaces are gone", lambda: not left & set(own_namespaces(platform)), seconds=60)
