"""Groups of tests: which tests each has, how it runs, and what came of it."""

from __future__ import annotations

import math
import os
import re
import sys
import tempfile
import time
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import chain, combinations
from pathlib import Path

from _pytest.mark.expression import Expression

from ci.durations import SECONDS_MIN, Durations
from ci.folders import PROJECT
from ci.test import child_runs, preparing, results, shared_servers

TOP = PROJECT
TESTS = "operator/tests"
EXAMPLES = "ROBOTKUBE_EXAMPLES"
MEMORY = Path("/dev/shm")  # noqa: S108 - the folder in it is made by tempfile
MEMORY_BYTES_MIN = 4 * 2**30
FEW_EXAMPLES, ALL_EXAMPLES = 10, 200
IMAGES_SECONDS_MAX = 1800
PLATFORM = f"{TESTS}/platform"  # its tests are marked by their folder
MARK = re.compile(r"\bpytest\.mark\.(processes|toolchain|thorough)\b")
OF_ALL = re.compile(r"^pytestmark = .*", re.MULTILINE)  # the marks of all tests of a file

FASTEST = "not processes and not toolchain and not platform and not thorough"
IN_PROCESSES = "(processes or toolchain) and not platform and not thorough"


@dataclass(frozen=True)
class Group:
    """One group of tests, those of its `marker`, or the checks when there is none.

    `goal_seconds` is what it may take on a quiet machine of two cores; `seconds_max`, and it is ended. `needs` is what
    `preparing.prepare` makes before. Each of the `processes` runs whole files, with servers of its own. `examples` is
    how many a random test tries, unless the environment says it. `beside` names the group beside which it runs, at the
    lowest priority, when both are run.
    """

    name: str
    marker: str
    goal_seconds: int
    needs: str
    processes: int = 1
    examples: int = ALL_EXAMPLES
    beside: str = ""

    @property
    def seconds_max(self) -> int:
        return 2 * self.goal_seconds + 300


ON_PLATFORM = Group("platform", "platform and not thorough", 620, "images")
FAST = Group("fast", FASTEST, 90, "tests", 3, FEW_EXAMPLES, beside=ON_PLATFORM.name)
GROUPS = (
    Group("check", "", 60, "nothing", beside=ON_PLATFORM.name),
    FAST,
    Group("processes", IN_PROCESSES, 320, "toolchain", 4),
    ON_PLATFORM,
)
THOROUGH = (
    Group("random", f"random and {FASTEST}", 600, "tests", 2),
    Group("proofs", "thorough and not platform", 3000, "images", 2),
    Group("clusters", "thorough and platform", 3000, "images"),
)


@dataclass(frozen=True)
class Result:
    """Counts of one group, its wall time in seconds, and why each of its failed tests failed."""

    group: Group
    passed: int
    failed: int
    skipped: int
    seconds: float
    failures: Mapping[str, str] = field(default_factory=dict)


def run_checks(group: Group, output: Path | None = None) -> results.Counts:
    code = child_runs.run([sys.executable, "-m", "ci.check"], TOP, group.name, group.seconds_max, output=output)
    return results.Counts(0, 1, 0) if code else results.Counts(1, 0, 0)


def run_pytest(group: Group, places: Sequence[str] = (TESTS,), output: Path | None = None) -> results.Counts:
    """Run a group's tests below some places. A run that ends badly without a failed test counts as one failure."""
    with temporary_folder(group) as (folder, environment):
        report = folder / "results"
        command = [sys.executable, "-m", "pytest", "-c", "operator/pyproject.toml", "-m", group.marker]
        command += ["--durations=10", "-p", "ci.test.results", "-p", "no:cacheprovider", *spread(group.processes)]
        command += chosen(group, places)
        environment[results.VARIABLE] = str(report)
        code = child_runs.run(command, TOP, group.name, group.seconds_max, environment, output)
        counts = results.read(report, code)
    if list(places) == [TESTS]:
        steps = {f"tests of {file}": max(seconds, SECONDS_MIN) for file, seconds in counts.seconds.items()}
        Durations().note_all(steps)
    if not counts.passed + counts.failed + counts.skipped:
        print(f"{group.name}: no test was run (pytest ended with {code})", flush=True)
    if code and not counts.failed:
        print(f"{group.name}: no test failed, but pytest ended with {code}: counted as one failure", flush=True)
        return results.Counts(counts.passed, 1, counts.skipped, failures={group.name: f"pytest ended with {code}"})
    return counts


def chosen(group: Group, places: Sequence[str]) -> list[str]:
    """The files below some places in which a test of the group can be, in the order of their turns: reading all of them
    takes each of its processes half a minute of a core, and so do as many options that leave one out. What is asked for
    by name stays, and so do all places when there is no such file."""
    files = (file for place in places for file in files_below(place))
    read = [file for file in files if file in places or can_have_tests(group, TOP / file)] or list(places)
    if group.processes == 1:
        return read
    known = Durations().known()
    return sorted(read, key=lambda place: turn(place.partition("::")[0], known))


def turn(file: str, known: Mapping[str, float]) -> tuple[bool, float]:
    """What decides when a file of tests is begun where several processes run them: those that share a server after all
    others, and of both those first of which nobody knows how long they take, then those that took longest at the last
    time. A long one that is begun at the end would leave the other processes without anything to do."""
    seconds = known.get(f"tests of {file.removeprefix('operator/')}", math.inf)
    return bool(shared_servers.servers_of(TOP / file)), -seconds


def files_below(place: str) -> list[str]:
    """The files of tests below a folder, or what else is named by `place`."""
    if not (TOP / place).is_dir():
        return [place]
    return [str(Path(place, file.relative_to(TOP / place))) for file in sorted((TOP / place).rglob("test_*.py"))]


def can_have_tests(group: Group, file: Path) -> bool:
    """Return whether a test of the group can be in a file, whose tests have the marks of all, and maybe others named
    there."""
    text = file.read_text("utf-8")
    of_all = {mark for line in OF_ALL.findall(text) for mark in MARK.findall(line)}
    of_all |= {"platform"} if TOP / PLATFORM in file.parents else set()
    others = [mark for mark in {*MARK.findall(text), "random"} if mark not in of_all]
    some = chain.from_iterable(combinations(others, count) for count in range(len(others) + 1))
    return any(chooses(group, of_all.union(more)) for more in some)


def chooses(group: Group, marks: Container[str]) -> bool:
    """Return whether a test with these marks is of the group."""
    return _compiled(group.marker).evaluate(lambda name, /, **_: name in marks)


@cache
def _compiled(marker: str) -> Expression:
    return Expression.compile(marker)


def spread(processes: int) -> list[str]:
    """Options that spread a group's files over processes, in their order and those together that share a server. When a
    process dies, the run ends."""
    if processes == 1:
        return []
    options = [f"--numprocesses={processes}", "--dist=loadfile", "--no-loadscope-reorder", "--max-worker-restart=0"]
    return [*options, "-p", "ci.test.shared_servers"]


@contextmanager
def temporary_folder(group: Group) -> Iterator[tuple[Path, dict[str, str]]]:
    """A folder that is deleted, and the environment in which a group's tests run: also what a killed process leaves in
    its folder for temporary files goes. Nodes of a cluster may run longer than the tests: theirs stays the machine's.
    Fast tests make and delete tens of thousands of small files, which is memory's work where it has room.
    """
    place = in_memory() if group.needs == "tests" else None
    with tempfile.TemporaryDirectory(prefix="robotkube-", dir=place, ignore_cleanup_errors=True) as folder:
        own = {} if group.needs == "images" else {"TMPDIR": folder}
        yield Path(folder), {EXAMPLES: str(group.examples), **os.environ, **own}


def in_memory(place: Path = MEMORY) -> str | None:
    """The folder whose files are kept in memory, where programs may be started from it and it has room."""
    try:
        room = os.statvfs(place)
    except OSError:
        return None
    free = min(room.f_bavail * room.f_frsize, os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    suits = not room.f_flag & os.ST_NOEXEC and free >= MEMORY_BYTES_MIN
    return str(place) if suits and os.access(place, os.W_OK) else None


def run(group: Group, places: Sequence[str], output: Path | None = None) -> Result:
    """Run a group; with an `output`, a file that its process writes to, at the lowest priority."""
    began = time.monotonic()
    counts = run_pytest(group, places, output) if group.marker else run_checks(group, output)
    seconds = time.monotonic() - began
    return Result(group, counts.passed, counts.failed, counts.skipped, seconds, counts.failures)


def run_all(groups: Sequence[Group], places: Sequence[str], finished: list[Result]) -> None:
    """Run groups one after the other, those that have one to be `beside` beside it; what is `finished` is added.
    Images that later groups need are made while one runs that has the tool chain and no use for them."""
    names = [group.name for group in groups]
    leading = [one for one in groups if one.beside not in names]
    for number, group in enumerate(leading):
        companions = {one.name: one for one in groups if one.beside == group.name}
        print(f"\n== {group.name}" + "".join(f", beside it {name}" for name in companions), flush=True)
        for one in (*companions.values(), group):
            preparing.prepare(one.needs)
        tasks: dict[str, Callable[[Path], Result | None]] = {
            name: partial(run, replace(one, goal_seconds=max(one.goal_seconds, group.goal_seconds)), places)
            for name, one in companions.items()
        }
        if group.needs == "toolchain" and "images" in (one.needs for one in leading[number:]):
            tasks = {"images for later groups": prepare_images, **tasks}
        with tempfile.TemporaryDirectory(prefix="robotkube-") as folder, ThreadPoolExecutor(1) as lane:
            beside = {name: lane.submit(task, Path(folder, name)) for name, task in tasks.items()}
            try:
                finished.append(run(group, places))
            except BaseException:
                for task in beside.values():
                    task.cancel()
                child_runs.interrupt()
                raise
            for name, task in beside.items():
                result = task.result()
                if result:
                    finished.append(replace(result, group=companions[name]))
                print(f"\n== {name}\n{Path(folder, name).read_text(errors='replace')}", flush=True)


def prepare_images(output: Path) -> None:
    """Make the images in a process of the lowest priority. Why that fails is said again when they are needed."""
    child_runs.run([sys.executable, "-m", "ci.images"], TOP, "images", IMAGES_SECONDS_MAX, output=output)


def failures(finished: Iterable[Result]) -> list[str]:
    """A line for each failed test of all groups: the reports stand far above, where who sees only the end does not."""
    return [f"failed: {test}: {why}" for one in finished for test, why in one.failures.items()]


def table(finished: Sequence[Result]) -> str:
    """One line per group, and the closing line with the sums. No goal holds for one that ran beside another."""
    lines = ["group      passed  failed skipped  seconds    goal"]
    sums = [0, 0, 0]
    names = [one.group.name for one in finished]
    for one in finished:
        counts = (one.passed, one.failed, one.skipped)
        late = "  late" if one.seconds > one.group.goal_seconds else ""
        if one.group.beside in names:
            late = f"  beside {one.group.beside}"
        cells = "{:>6} {:>7} {:>7}".format(*counts)
        lines.append(f"{one.group.name:<10} {cells} {one.seconds:>8.1f} {one.group.goal_seconds:>7}{late}")
        sums = [total + count for total, count in zip(sums, counts, strict=True)]
    return "\n".join([*lines, "{} passed, {} failed, {} skipped".format(*sums)])
