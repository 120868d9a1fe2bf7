"""Which process of a run takes which file of tests: those that share a server stay together."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from ci.test import groups, shared_servers
from ci.test.shared_servers import next_of, servers_of
from tests.stages.paths import REPOSITORY

pytestmark = pytest.mark.processes

NONE = frozenset[str]()
SECONDS_MAX = 60
USING = """
import os, pathlib, time
OTHER = {{"api": "forge", "forge": "api"}}
def test_it({asks}):
    _, number, _, server = pathlib.Path(__file__).stem.split("_")
    pathlib.Path("ran", f"{{number}}_{{server}}").write_text(str(os.getpid()))
    while not pathlib.Path("ran", f"{{number}}_{{OTHER[server]}}").exists():
        time.sleep(0.02)
"""
FIXTURES = """
import pytest
class Api: ...
class Installation: ...
@pytest.fixture(scope="session")
def api(): return Api()
@pytest.fixture(scope="session")
def installation(): return Installation()
"""


@pytest.mark.parametrize(
    ("own", "others", "taken"),
    [
        ([], [[]], "plain"),
        (["forge"], [["API server"]], "plain"),
    ],
)
def test_what_needs_no_server_comes_in_its_order(
    own: Sequence[str], others: Sequence[Sequence[str]], taken: str
) -> None:
    waiting = {"plain": NONE, "second": NONE, "asks": frozenset({"forge"})}
    assert next_of(waiting, frozenset(own), map(frozenset, others)) == taken


@pytest.mark.parametrize(
    ("own", "others", "taken"),
    [
        ([], [[], []], "api"),  # nobody runs one: the first
        ([], [["API server"], []], "forge"),  # one that nobody runs, before a second API server
        ([], [["API server"], ["forge"]], "api"),  # a second one, since all others run already
        (["forge"], [[]], "forge"),  # its own, before a new one
        (["forge"], [["API server"]], "forge"),
        (["API server", "forge"], [[]], "api"),
        (["API server", "forge"], [["API server", "forge"]], "api"),
    ],
)
def test_a_process_takes_files_of_servers_that_it_runs(
    own: Sequence[str], others: Sequence[Sequence[str]], taken: str
) -> None:
    api, forge = frozenset({"API server"}), frozenset({"forge"})
    waiting = {"api": api, "both": api | forge, "forge": forge}
    assert next_of(waiting, frozenset(own), map(frozenset, others)) == taken


def test_files_name_their_servers() -> None:
    tests = REPOSITORY / "operator" / "tests"
    assert servers_of(tests / "delivery/tasks/test_custom_resource.py") == {"API server"}
    assert servers_of(tests / "delivery/manager/processes/test_process.py") == {"API server of the agents", "forge"}
    assert servers_of(tests / "delivery/gate/test_gate.py") == {"forge"}
    assert servers_of(tests / "registry/admission/test_remover_api_server.py") == {"API server under policies"}
    assert servers_of(tests / "registry/admission/test_volumes_api_server.py") == NONE, "it has one of its own"
    assert servers_of(tests / "ci/test_results_none.py") == NONE
    asked = {name for file in tests.rglob("test_*.py") for name in servers_of(file)}
    assert asked == set(shared_servers.FIXTURES), "each name is asked for"


def test_files_of_one_server_run_in_one_process(tmp_path: Path) -> None:
    """Each test ends when that of the other server is there, so neither process is ahead; the last files may go to who
    is free first."""
    (tmp_path / "ran").mkdir()
    (tmp_path / "conftest.py").write_text(FIXTURES)
    servers = {"api": "api: Api", "forge": "installation: Installation"}
    for number in range(6):
        turns = [*servers] if number % 2 else [*reversed(servers)]  # one after the other would mix them
        for turn, server in enumerate(turns):
            text = USING.format(asks=servers[server].partition(":")[0]) + f"# {servers[server]}\n"
            (tmp_path / f"test_{number}_{turn}_{server}.py").write_text(text)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path), *groups.spread(2)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=SECONDS_MAX, check=False)
    assert done.returncode == 0, done.stdout
    ran = {server: {(tmp_path / "ran" / f"{number}_{server}").read_text() for number in range(4)} for server in servers}
    assert [len(processes) for processes in ran.values()] == [1, 1]
    assert ran["api"] != ran["forge"]
