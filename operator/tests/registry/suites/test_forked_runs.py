"""Suites in processes of their own: results come back; hanging, crashing and flooding ends the process and no other."""

import threading
from collections.abc import Callable, Iterator
from multiprocessing.process import BaseProcess
from pathlib import Path

import pytest

from robotkube.errors import RobotKubeError
from robotkube.registry.suites.adapters.forked_runs import ForkedSuites
from robotkube.testing.suites import make_request, passed
from tests.stages.registry import forked_targets
from tests.stages.waiting import until

pytestmark = pytest.mark.processes


@pytest.fixture(scope="module")
def suites() -> Iterator[ForkedSuites]:
    forked = ForkedSuites(forked_targets.run, ["tests.stages.registry.forked_targets"], late_seconds=1)
    yield forked
    forked.stop()


def alive(process: int) -> bool:
    try:
        return "\nState:\tZ" not in Path(f"/proc/{process}/status").read_text()
    except OSError:
        return False


def test_a_result_comes_back(suites: ForkedSuites) -> None:
    request = make_request(command=("pass",))
    assert suites.execute(request, "") == passed(request)


def test_a_suite_that_hangs_is_ended_with_everything_it_started(suites: ForkedSuites, tmp_path: Path) -> None:
    note = tmp_path / "processes"
    with pytest.raises(RobotKubeError, match="did not end within its 1 s and was ended"):
        suites.execute(make_request(seconds=1, command=("hang", str(note))), "")
    processes = [int(word) for word in note.read_text().split()]
    assert len(processes) == 2
    until(lambda: not any(alive(process) for process in processes), "both gone")


def test_stopping_ends_what_runs(suites: ForkedSuites, tmp_path: Path) -> None:
    note = tmp_path / "processes"
    errors = []

    def run() -> None:
        try:
            suites.execute(make_request(seconds=600, command=("hang", str(note))), "")
        except RobotKubeError as error:
            errors.append(str(error))

    thread = threading.Thread(target=run)
    thread.start()
    until(lambda: note.is_file() and len(note.read_text().split()) == 2, "it runs")
    suites.stop()
    thread.join(10)
    assert errors == ["the suite's process ended without a result (SIGKILL; SIGKILL is mostly a lack of memory)"]


def test_stopping_ends_what_has_just_been_started(
    suites: ForkedSuites, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start: Callable[[BaseProcess], None] = suites._context.Process.start

    def start_while_it_is_stopped(process: BaseProcess) -> None:
        start(process)
        stopping = threading.Thread(target=suites.stop)
        stopping.start()
        stopping.join(0.2)

    monkeypatch.setattr(suites._context.Process, "start", start_while_it_is_stopped)
    with pytest.raises(RobotKubeError, match=r"ended without a result .SIGKILL"):
        suites.execute(make_request(seconds=5, command=("hang", str(tmp_path / "processes"))), "")


@pytest.mark.parametrize(
    ("word", "words"),
    [
        ("crash", "ended without a result .exit code 7"),
        ("raise", "ended without a result .exit code 1"),
        ("memory", "ended without a result"),
        ("flood", "longer than 4194304 bytes"),
        ("nothing", "gave no result"),
    ],
)
def test_processes_without_a_result(suites: ForkedSuites, word: str, words: str) -> None:
    with pytest.raises(RobotKubeError, match=words):
        suites.execute(make_request(command=(word,)), "")
