"""`make test` itself: every test is in one group, and its counts are right however a run ends."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from ci.durations import Durations
from ci.test import child_runs, groups, preparing, results
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

SECONDS_MAX = 60
MARKS = ("processes", "toolchain", "platform", "thorough")
MIXED = """
import pytest
def test_passes(): pass
def test_fails(): assert False
@pytest.mark.skip(reason="for the count")
def test_is_skipped(): pass
@pytest.fixture
def broken():
    yield
    raise RuntimeError("teardown")
def test_fails_in_its_teardown(broken): pass
"""
DYING = """
import os, signal
def test_passes(): pass
def test_kills_the_run(): os.kill(os.getpid(), signal.SIGKILL)
def test_never_runs(): pass
"""


SLEEPING = [
    sys.executable,
    "-c",
    """
import pathlib, time
try:
    pathlib.Path("sleeping").touch()
    time.sleep(600)
except KeyboardInterrupt:
    raise SystemExit(7)
""",
]
HANGING = """
import pathlib, time, pytest
@pytest.fixture(scope="session")
def server():
    yield
    time.sleep(1)
    pathlib.Path("taken-down").touch()
def test_passes(): pass
def test_hangs(server):
    pathlib.Path("hanging").touch()
    time.sleep(600)
"""


@pytest.fixture(autouse=True)
def _durations_of_its_own(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))


def counted(folder: Path, name: str, text: str, processes: int = 1) -> tuple[int, results.Counts]:
    """Exit code and counts of a pytest run of one file."""
    (folder / f"test_{name}.py").write_text(text)
    environment = {**os.environ, results.VARIABLE: str(folder / "results")}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "ci.test.results", "-p", "no:cacheprovider", str(folder)]
    command += groups.spread(processes)
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, timeout=SECONDS_MAX, check=False)
    return done.returncode, results.read(folder / "results", done.returncode)


@pytest.mark.parametrize("marks", [c for n in range(5) for c in itertools.combinations(MARKS, n)], ids=" and ".join)
def test_a_test_of_any_marks_is_in_one_group(marks: tuple[str, ...]) -> None:
    chosen = [
        group.name for group in (*groups.GROUPS, *groups.THOROUGH) if group.marker and groups.chooses(group, marks)
    ]
    assert len(chosen) == 1


WRITTEN = ("pytestmark = {}\n", "import pytest\n\npytestmark = [{}]\n", "@{}\ndef test_it() -> None: ...\n")


def one_test(top: Path, marks: Sequence[str], written: str) -> Path:
    """A file whose test has these marks; `platform` is that of its folder."""
    folder = top / (groups.PLATFORM if "platform" in marks else groups.TESTS) / "subject"
    folder.mkdir(parents=True)
    words = [f"pytest.mark.{mark}" for mark in marks if mark != "platform"]
    joined = ("\n@" if written.startswith("@") else ", ").join(words)
    (folder / "test_it.py").write_text(written.format(joined) if words else "def test_it() -> None: ...\n")
    return folder / "test_it.py"


def with_tests() -> list[groups.Group]:
    return [group for group in (*groups.GROUPS, *groups.THOROUGH) if group.marker]


def reads(group: groups.Group) -> bool:
    """Return whether the group reads the one file of tests that there is."""
    return groups.chosen(group, [groups.TESTS]) != [groups.TESTS]


@pytest.mark.parametrize("written", WRITTEN, ids=["one", "list", "test"])
@pytest.mark.parametrize("marks", [c for n in range(5) for c in itertools.combinations(MARKS, n)], ids=" and ".join)
def test_a_file_is_read_by_the_group_of_its_test(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, marks: tuple[str, ...], written: str
) -> None:
    one_test(tmp_path, marks, written)
    monkeypatch.setattr(groups, "TOP", tmp_path)
    chosen = {
        group.name
        for group in (*groups.GROUPS, *groups.THOROUGH)
        if group.marker and groups.chooses(group, {*marks, "random"})
    }
    assert chosen, "a test of any marks is in a group"
    assert chosen <= {group.name for group in with_tests() if reads(group)}
    assert not reads(groups.ON_PLATFORM) or "platform" in marks


@pytest.mark.parametrize(
    ("marks", "read_by"),
    [
        ((), {"fast", "random"}),
        (("processes",), {"processes"}),
        (("thorough",), {"proofs"}),
        (("platform",), {"platform"}),
        (("platform", "thorough"), {"clusters"}),
    ],
)
def test_what_cannot_have_a_test_of_the_group_is_not_read(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, marks: tuple[str, ...], read_by: set[str]
) -> None:
    file = one_test(tmp_path, marks, WRITTEN[0])
    monkeypatch.setattr(groups, "TOP", tmp_path)
    assert {group.name for group in with_tests() if reads(group)} == read_by
    for place in (str(file), f"{file}::test_it"):
        assert groups.chosen(groups.FAST, [place]) == [place], "what is asked for by name is read"


def test_files_are_read_in_the_order_of_places_and_names(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(groups, "TOP", tmp_path)
    names = ["b/test_1.py", "a/test_2.py", "a/test_1.py", "a/stage.py"]
    for name in names:
        (tmp_path / groups.TESTS / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / groups.TESTS / name).write_text("")
    inside = [f"{groups.TESTS}/{name}" for name in ("a/test_1.py", "a/test_2.py", "b/test_1.py")]
    assert groups.chosen(groups.FAST, [groups.TESTS]) == inside
    assert groups.chosen(groups.FAST, [f"{groups.TESTS}/b", f"{groups.TESTS}/a"]) == [*inside[2:], *inside[:2]]
    assert groups.chosen(groups.ON_PLATFORM, [groups.TESTS]) == [groups.TESTS], "never nothing, which would be all"


def test_files_whose_tests_share_a_server_are_read_last(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(groups, "TOP", tmp_path)
    group = next(group for group in groups.GROUPS if group.name == "processes")
    folder = tmp_path / groups.TESTS
    folder.mkdir(parents=True)
    for name, asks in (("a", "api_server: ApiServerProcess"), ("b", "tmp_path: Path"), ("c", "api: Api"), ("d", "")):
        text = f"pytestmark = pytest.mark.processes\ndef test_it({asks}) -> None: ...\n"
        (folder / f"test_{name}.py").write_text(text)
    assert [Path(file).stem[-1] for file in groups.chosen(group, [groups.TESTS])] == ["b", "d", "a", "c"]
    assert [Path(file).stem[-1] for file in groups.chosen(replace(group, processes=1), [groups.TESTS])] == [
        *("a", "b", "c", "d")
    ]


def test_what_took_longest_is_begun_first(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Of the files that share a server, and of all others; one that nobody knows, before what is known."""
    monkeypatch.setattr(groups, "TOP", tmp_path)
    group = next(group for group in groups.GROUPS if group.name == "processes")
    (tmp_path / groups.TESTS).mkdir(parents=True)
    for name, asks in (("a", ""), ("b", ""), ("c", "api: Api"), ("d", "api: Api"), ("e", "")):
        text = f"pytestmark = pytest.mark.processes\ndef test_it({asks}) -> None: ...\n"
        (tmp_path / groups.TESTS / f"test_{name}.py").write_text(text)
    taken = {"a": 2.0, "b": 3.0, "c": 40.0, "d": 50.0}
    Durations().note_all({f"tests of tests/test_{name}.py": seconds for name, seconds in taken.items()})
    assert [Path(file).stem[-1] for file in groups.chosen(group, [groups.TESTS])] == ["e", "b", "a", "d", "c"]


@pytest.mark.parametrize("mark", ["", *MARKS])
def test_a_random_test_that_is_fast_is_tried_with_more_examples_too(mark: str) -> None:
    marks = {"random", mark}
    chosen = {
        group.name: group.examples
        for group in (*groups.GROUPS, *groups.THOROUGH)
        if group.marker and groups.chooses(group, marks)
    }
    fast = {"fast": groups.FEW_EXAMPLES, "random": groups.ALL_EXAMPLES}
    assert chosen == fast if not mark else len(chosen) == 1


def test_a_group_says_how_many_examples(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the environment says goes first."""
    monkeypatch.delenv(groups.EXAMPLES, raising=False)
    for group in (*groups.GROUPS, *groups.THOROUGH):
        few = group is groups.FAST
        with groups.temporary_folder(group) as (_, environment):
            assert environment[groups.EXAMPLES] == str(groups.FEW_EXAMPLES if few else groups.ALL_EXAMPLES)
    monkeypatch.setenv(groups.EXAMPLES, "7")
    with groups.temporary_folder(groups.FAST) as (_, environment):
        assert environment[groups.EXAMPLES] == "7"


def test_temporary_files_are_in_memory_where_that_has_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(groups, "MEMORY_BYTES_MIN", 1)
    assert groups.in_memory(tmp_path) == str(tmp_path)
    assert groups.in_memory(tmp_path / "none") is None
    monkeypatch.setattr(groups, "MEMORY_BYTES_MIN", 2**60)
    assert groups.in_memory(tmp_path) is None


def test_each_test_counts_once_as_its_worst(tmp_path: Path) -> None:
    code, counts = counted(tmp_path, "mixed", MIXED)
    assert (code, counts) == (1, results.Counts(1, 2, 1))
    assert set(counts.seconds) == {"test_mixed.py"}


def test_each_failure_says_why(tmp_path: Path) -> None:
    _, counts = counted(tmp_path, "mixed", MIXED)
    assert len(counts.failures) == counts.failed
    finished = [
        groups.Result(groups.FAST, 1, 2, 1, 2.0, counts.failures),
        groups.Result(groups.GROUPS[2], 1, 0, 0, 2.0),
    ]
    lines = groups.failures(finished)
    assert [line.split("::")[0] for line in lines] == ["failed: test_mixed.py"] * 2
    assert all(line.split(": ", 2)[2] for line in lines)


def test_a_run_that_is_killed_keeps_its_counts(tmp_path: Path) -> None:
    code, counts = counted(tmp_path, "dying", DYING)
    assert code == -9
    assert counts == results.Counts(1, 1, 0, ("test_dying.py::test_kills_the_run",))
    assert counts.failures["test_dying.py::test_kills_the_run"].endswith("in the middle of it: pytest ended by SIGKILL")


INTERRUPTED = """
import os, pathlib, signal, time
STARTED_BY = os.getppid()
def test_ends():
    noted = pathlib.Path(os.environ["ROBOTKUBE_TEST_RESULTS"])
    while "test_ends" not in (noted.read_text() if noted.exists() else ""):
        time.sleep(0.05)
    os.kill(STARTED_BY, signal.SIGINT)
    time.sleep(60)
"""
WITH_ERROR = """
class Plugin:
    def pytest_runtest_logreport(self, report): raise ValueError("of a plugin")
def test_ends(request): request.config.pluginmanager.register(Plugin())
"""


@pytest.mark.parametrize(
    ("text", "said"), [(INTERRUPTED, "pytest was interrupted"), (WITH_ERROR, "ValueError: of a plugin")]
)
def test_a_run_that_ends_without_a_failure_says_why(tmp_path: Path, text: str, said: str) -> None:
    """The process that started the others is interrupted, or one of them has an error of its own."""
    _, counts = counted(tmp_path, "ending", text, 2)
    assert said in counts.failures["test_ending.py::test_ends"]


def test_a_run_of_which_one_process_is_killed_keeps_its_counts(tmp_path: Path) -> None:
    (tmp_path / "test_other.py").write_text(MIXED)
    code, counts = counted(tmp_path, "dying", DYING, 2)
    assert code == 1
    assert counts == results.Counts(2, 3, 1)


def test_a_file_that_cannot_be_imported_is_a_failure(tmp_path: Path) -> None:
    code, counts = counted(tmp_path, "broken", "import nothing_of_this_name\n")
    assert code != 0
    assert counts == results.Counts(0, 1, 0)
    assert "nothing_of_this_name" in counts.failures["test_broken.py"]


def test_of_several_ends_the_first_says_why(tmp_path: Path) -> None:
    """pytest-xdist may not expect what becomes of a run in which a plugin has an error."""
    facts = [{"test": "a", "outcome": "started", "why": ""}, {"ended": "of a plugin"}, {"ended": "of pytest-xdist"}]
    (tmp_path / "results").write_text("".join(f"{json.dumps(fact)}\n" for fact in facts))
    assert results.read(tmp_path / "results").failures == {"a": "the run ended in the middle of it: of a plugin"}


def test_no_run_at_all_counts_nothing(tmp_path: Path) -> None:
    assert results.read(tmp_path / "results") == results.Counts(0, 0, 0)


@pytest.mark.parametrize(
    ("processes", "text", "passed"),
    [(1, MIXED, 1), (1, "", 0), (1, DYING, 1), (2, "", 0)],
    ids=["failing", "empty", "dying", "empty of two"],
)
def test_a_group_with_a_failure_or_without_a_test_has_failed(
    processes: int,
    text: str,
    passed: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "operator" / "tests" / "some").mkdir(parents=True)
    (tmp_path / "operator" / "pyproject.toml").write_text("[tool.pytest.ini_options]\nmarkers = ['thorough: slow']\n")
    (tmp_path / "operator" / "tests" / "some" / "test_some.py").write_text(text)
    monkeypatch.setattr(groups, "TOP", tmp_path)
    counts = groups.run_pytest(groups.Group("some", "not thorough", 20, "nothing", processes))
    assert counts.passed == passed
    assert counts.failed >= 1
    assert ("no test was run" in capsys.readouterr().out) == (not passed)
    ended_by_itself = text != DYING
    assert ("tests of tests/some/test_some.py" in Durations().known()) == (bool(text) and ended_by_itself)


@pytest.mark.parametrize("processes", [1, 2])
def test_a_group_that_hangs_is_taken_down_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, processes: int
) -> None:
    (tmp_path / "operator" / "tests" / "some").mkdir(parents=True)
    (tmp_path / "operator" / "pyproject.toml").touch()
    (tmp_path / "operator" / "tests" / "some" / "test_some.py").write_text(HANGING)
    monkeypatch.setattr(groups, "TOP", tmp_path)
    wait = child_runs.wait
    hanging = tmp_path / "hanging"
    monkeypatch.setattr(child_runs, "wait", lambda process, name, _: wait(process, name, over_when(hanging)))
    counts = groups.run_pytest(groups.Group("some", "not thorough", 1, "nothing", processes))
    assert (counts.passed, counts.failed) == (1, 1)
    assert (tmp_path / "taken-down").exists()


def over_when(file: Path) -> float:
    """A group's time, which is over when the file is there."""
    until(file.exists, "the test that hangs", SECONDS_MAX)
    return 0.1


MEETING = """
import os, pathlib, time, pytest
def met(own, other):
    pathlib.Path(own).write_text(str(os.getpriority(os.PRIO_PROCESS, 0)))
    for _ in range(600):
        if pathlib.Path(other).exists():
            return True
        time.sleep(0.1)
@pytest.mark.thorough
def test_meets_the_first():
    assert met("second", "first")
def test_meets_the_second():
    assert met("first", "second")
"""


def test_a_group_runs_beside_another_at_the_lowest_priority(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "operator" / "tests" / "some").mkdir(parents=True)
    (tmp_path / "operator" / "pyproject.toml").write_text("[tool.pytest.ini_options]\nmarkers = ['thorough: slow']\n")
    (tmp_path / "operator" / "tests" / "some" / "test_some.py").write_text(MEETING)
    monkeypatch.setattr(groups, "TOP", tmp_path)
    first = groups.Group("first", "not thorough", 60, "nothing")
    second = groups.Group("second", "thorough", 1, "nothing", beside="first")
    finished: list[groups.Result] = []
    groups.run_all([second, first], [groups.TESTS], finished)
    assert [(one.group, one.passed, one.failed) for one in finished] == [(first, 1, 0), (second, 1, 0)]
    assert (tmp_path / "second").read_text() == "19"
    assert (tmp_path / "first").read_text() == str(os.getpriority(os.PRIO_PROCESS, 0))  # this test's own
    printed = capfd.readouterr().out
    assert printed.index("== first, beside it second") < printed.index("== second\n")
    assert printed.count("1 passed") == 2
    lines = groups.table(finished).splitlines()
    assert lines[2].endswith("beside first")


WAITING = """
import pathlib, time
def test_waits():
    pathlib.Path("running").touch()
    for _ in range(600):
        if pathlib.Path("images").exists():
            return
        time.sleep(0.1)
    raise AssertionError("no images")
"""


def test_images_are_made_while_a_group_runs_that_needs_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "operator" / "tests" / "some").mkdir(parents=True)
    (tmp_path / "operator" / "pyproject.toml").touch()
    (tmp_path / "operator" / "tests" / "some" / "test_some.py").write_text(WAITING)

    def prepare_images(output: Path) -> None:
        until((tmp_path / "running").exists, "the group that runs", SECONDS_MAX)
        output.write_text("what the builds say")
        (tmp_path / "images").touch()

    needed: list[str] = []
    monkeypatch.setattr(groups, "TOP", tmp_path)
    monkeypatch.setattr(groups, "prepare_images", prepare_images)
    monkeypatch.setattr(preparing, "prepare", needed.append)
    first = groups.Group("first", "not thorough", 60, "toolchain")
    second = groups.Group("second", "not thorough", 60, "images")
    finished: list[groups.Result] = []
    groups.run_all([first, second], [groups.TESTS], finished)
    assert [(one.passed, one.failed) for one in finished] == [(1, 0), (1, 0)]
    assert needed == ["toolchain", "images"]
    printed = capfd.readouterr().out
    assert printed.count("what the builds say") == 1
    assert printed.index("== images for later groups") < printed.index("== second")


def test_an_interrupt_ends_what_runs_beside(tmp_path: Path) -> None:
    with ThreadPoolExecutor(1) as lane:
        running = lane.submit(child_runs.run, SLEEPING, tmp_path, "some", 600, None, tmp_path / "output")
        until((tmp_path / "sleeping").exists, "the process", SECONDS_MAX)
        child_runs.interrupt()
        assert running.result(SECONDS_MAX) == 7


def test_the_last_line_sums_all_groups() -> None:
    finished = [
        groups.Result(groups.GROUPS[0], 1, 0, 0, 2.0),
        groups.Result(groups.GROUPS[1], 600, 2, 3, 301.0),
    ]
    lines = groups.table(finished).splitlines()
    assert lines[-1] == "601 passed, 2 failed, 3 skipped"
    assert lines[2].endswith("late")
    assert not lines[1].endswith("late")
