"""The section about walks in docs/explanation/architecture.md, counted by running them.

`make reference` writes it between its markers; a test compares, and refuses a walk that is longer than its bound.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ci.docs import markdown
from ci.reference.architecture import PAGE, purpose
from ci.reference.walks import pose, submission, task
from ci.reference.walks.recording import SOURCE, Route, Station, WalkRecorder

BEGIN, END = "<!-- walks: make reference writes this -->", "<!-- walks end -->"


@dataclass(frozen=True)
class Walk:
    """A walk that is written down: from where to where it leads, in words; the most files that it may touch; the route
    of the value, and the function that has it go there."""

    title: str
    story: str
    files_max: int
    route: Callable[[], Route]
    run: Callable[[WalkRecorder], None]


@dataclass(frozen=True)
class Count:
    """A walk as it was counted: its stations, the other files whose code ran, and what is wrong with it."""

    walk: Walk
    stations: Sequence[Station]
    looked_up: Sequence[str]
    problems: Sequence[str]


WALKS = (
    Walk(
        "A pose to an event",
        "From a pose that waits in the middleware to the event that is raised, by a rule about the distance of two "
        "vehicles.",
        8,
        pose.route,
        pose.run,
    ),
    Walk(
        "A task to a commit",
        "From a TaskDescription at the API server to the commit that is proposed; what the gate does with it begins "
        "another walk. The application has a recorder and a link, and so a bridge.",
        15,
        task.route,
        task.run,
    ),
    Walk(
        "A submission to a publication",
        "From a pull request at the catalogue to the commit on its main, through the suite-runner: the static suite "
        "stands for all, each is one file in its place.",
        15,
        submission.route,
        submission.run,
    ),
)


def count(walk: Walk) -> Count:
    """Run a walk and count it."""
    recorder = WalkRecorder(walk.route())
    walk.run(recorder)
    stations = list(recorder.stations.values())
    looked_up = sorted(module_of(path) for path in recorder.files - recorder.stations.keys())
    problems = [f"{walk.title}: the value did not pass {name}" for name in recorder.missed]
    problems += [f"{walk.title}: {name} gives the value; say which adapter that is" for name in recorder.unknown]
    if len(stations) > walk.files_max:
        problems.append(f"{walk.title}: {len(stations)} files, at most {walk.files_max}; look for what only passes on")
    return Count(walk, stations, looked_up, problems)


def counted() -> list[Count]:
    """All walks."""
    return [count(walk) for walk in WALKS]


def module_of(path: Path) -> str:
    """The file as the page names it, such as `robots/detector/loops/detector.py`."""
    return str(path.relative_to(SOURCE))


def section(counts: Sequence[Count]) -> str:
    """What stands between the markers."""
    lines = [BEGIN, ""]
    for one in counts:
        lines += [f"### {one.walk.title}", ""]
        lines += [f"{len(one.stations)} files, at most {one.walk.files_max}. {one.walk.story}", ""]
        lines += ["| | file | entered at | what it is | made there |", "| --- | --- | --- | --- | --- |"]
        lines += [row(number, station) for number, station in enumerate(one.stations, 1)] + [""]
    return markdown.wrapped("\n".join(lines)).rstrip() + f"\n\n{END}"


def row(number: int, station: Station) -> str:
    """The line of a file."""
    file = module_of(station.path)
    forms = ", ".join(f"`{form}`" for form in dict.fromkeys(station.forms))
    words = " ".join(purpose(file.removesuffix(".py").replace("/", ".")).split())
    return f"| {number} | `{file}` | `{station.entered}` | {words} | {forms} |"


def rewritten(page: str, counts: Sequence[Count]) -> str:
    """The page with this section."""
    before, rest = page.split(BEGIN, 1)
    return before + section(counts) + rest.split(END, 1)[1]


def write() -> None:
    """Write the page."""
    PAGE.write_text(rewritten(PAGE.read_text(encoding="utf-8"), counted()), encoding="utf-8")
