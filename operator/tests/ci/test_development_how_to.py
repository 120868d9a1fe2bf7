"""docs/how-to/run-a-process-from-a-clone.md: its commands, as they stand there."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from benchmarks.measuring.pods import free_port
from tests.stages import http_calls
from tests.stages.kubernetes.api_calls import Api
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.paths import REPOSITORY
from tests.stages.programs import program
from tests.stages.waiting import until

PAGE = REPOSITORY / "docs/how-to/run-a-process-from-a-clone.md"
BLOCKS = re.findall(r"```bash\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
SECRETS, GATE, SUITE_RUNNER, LEASE, MANAGER = BLOCKS
COMMAND_SECONDS_MAX, END_SECONDS_MAX = 120, 20.0


def bash(script: str) -> list[str]:
    return ["bash", "-euc", script]


@contextmanager
def started(script: str, folder: Path, **environment: str) -> Iterator[str]:
    """The address of a process of the page, which is alive; its files are below `folder`, and its port is a free one.
    It must end with 0 on SIGTERM."""
    variables = {**os.environ, "DEV": str(folder), **environment}
    subprocess.run(bash(SECRETS), cwd=REPOSITORY, env=variables, check=True, timeout=COMMAND_SECONDS_MAX)
    port = free_port()
    own, count = re.subn(r"port: \d+", f"port: {port}", script)
    assert count == 1
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(bash(own), cwd=REPOSITORY, env=variables, stderr=log)
    url = f"http://127.0.0.1:{port}"

    def alive() -> bool:
        assert process.poll() is None, (folder / "log").read_text()
        try:
            return http_calls.get(f"{url}/livez").is_success
        except httpx.HTTPError:
            return False

    try:
        until(alive, "alive")
        yield url
        process.terminate()
        assert process.wait(END_SECONDS_MAX) == 0, (folder / "log").read_text()
    finally:
        process.kill()
        process.wait(END_SECONDS_MAX)


@pytest.mark.processes
def test_the_gate_starts_and_says_what_it_misses(tmp_path: Path) -> None:
    with started(GATE, tmp_path) as url:
        answer = http_calls.get(f"{url}/readyz")
        assert (answer.status_code, "the forge was not seen" in answer.text) == (503, True)


@pytest.mark.processes
def test_the_suite_runner_starts(tmp_path: Path) -> None:
    with started(SUITE_RUNNER, tmp_path) as url:
        assert http_calls.get(f"{url}/readyz").text == "ok\n"


@pytest.mark.toolchain
def test_the_manager_starts_at_a_cluster(tmp_path: Path, api: Api, api_server: ApiServerProcess) -> None:
    path = os.pathsep.join((str(Path(program("kubectl")).parent), os.environ["PATH"]))
    environment = {"KUBECONFIG": str(api_server.kubeconfig), "PATH": path}
    subprocess.run(bash(LEASE), env={**os.environ, **environment}, check=True, timeout=COMMAND_SECONDS_MAX)
    with started(MANAGER, tmp_path, **environment) as url:
        until(lambda: "leading" in (tmp_path / "log").read_text(), "leading")
        assert http_calls.get(f"{url}/readyz").status_code == 503
