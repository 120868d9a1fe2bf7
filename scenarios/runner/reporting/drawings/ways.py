"""An event's way as a Gantt chart: one of the deployment, to the first stored cloud, and one of the removal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from xml.etree.ElementTree import Element

from scenarios.runner.reporting.drawings.drawing import (
    BOTTOM,
    RIGHT,
    Axes,
    Drawing,
    KeyEntry,
    NoDrawingError,
    picture,
    shortened,
)
from scenarios.runner.reporting.drawings.elements import label, line, rectangle
from scenarios.runner.reporting.drawings.reading import Document, finite
from scenarios.runner.reporting.drawings.scales import Scale

ENCOUNTERS_MAX = 6
NAMES, TOP, ROW_HEIGHT, BAR_HEIGHT = 104.0, 6.0, 17.0, 11.0
VALUES, WIDTH_MIN = 40.0, 1.2
PHASES = (
    ("deployment", "from the event to the first stored cloud"),
    ("removal", "from its end to the last pod gone"),
)


@dataclass(frozen=True)
class Bar:
    """A step in s since the phase began."""

    step: str
    begin: float
    end: float
    critical: bool


def ways(document: Document) -> Iterator[Drawing]:
    """Two drawings per encounter, at most of ENCOUNTERS_MAX."""
    met = document["drawings"].get("encounters")
    if not met:
        raise NoDrawingError("there are no encounters in report.json")
    for number, one in enumerate(met[:ENCOUNTERS_MAX], 1):
        for phase, words in PHASES:
            bars = _bars(one.get(phase) or [])
            if bars:
                yield _gantt(f"ways-{number}-{phase}", f"Encounter {number}: {words}", bars)


def _bars(steps: Sequence[Document]) -> list[Bar]:
    known = [
        Bar(str(step["step"]), begin, end, bool(step["critical"]))
        for step in steps
        if (begin := finite(step["begin"])) is not None and (end := finite(step["end"])) is not None and begin <= end
    ]
    first = min((bar.begin for bar in known), default=0.0)
    return [Bar(bar.step, bar.begin - first, bar.end - first, bar.critical) for bar in known]


def _gantt(name: str, title: str, bars: Sequence[Bar]) -> Drawing:
    bottom = TOP + ROW_HEIGHT * len(bars)
    axes = Axes(Scale(0.0, max(0.001, *(bar.end for bar in bars)), NAMES, RIGHT - VALUES), Scale(0.0, 1.0, bottom, TOP))
    parts = [
        axes.drawn("seconds since the triggering pose", ""),
        *_joints(axes, bars),
        *(part for row, bar in enumerate(bars) for part in _row(axes, row, bar)),
    ]
    path = [bar for bar in bars if bar.critical]
    critical = ", ".join(f"{bar.step} {bar.end - bar.begin:.3f} s" for bar in path)
    whole = max((bar.end for bar in path), default=0.0)
    key = [KeyEntry(f"critical path, {whole:.3f} s", "critical")]
    key += [KeyEntry("beside it", "beside")] if len(path) < len(bars) else []
    return Drawing(title, picture(name, title, f"Critical path: {critical}.", bottom + BOTTOM, parts), tuple(key))


def _row(axes: Axes, row: int, bar: Bar) -> Iterator[Element]:
    top = TOP + ROW_HEIGHT * row + (ROW_HEIGHT - BAR_HEIGHT) / 2
    left, right = axes.x(bar.begin), axes.x(bar.end)
    kind = "critical" if bar.critical else "beside"
    text = f"{bar.end - bar.begin:.3f} s"
    yield label((NAMES - 5, top + 9), shortened(bar.step, NAMES - 6), "label", "end")
    yield rectangle((left, top), max(right - left, WIDTH_MIN), BAR_HEIGHT, kind, f"{bar.step}: {text}")
    yield label((right + 4, top + 9), text, "tick")


def _joints(axes: Axes, bars: Sequence[Bar]) -> Iterator[Element]:
    """Lines from a critical step to the next, where one follows the other at once."""
    path = [(row, bar) for row, bar in enumerate(bars) if bar.critical]
    for (row, bar), (following, after) in pairwise(path):
        if abs(bar.end - after.begin) < 1e-5:
            place = axes.x(bar.end)
            yield line((place, TOP + ROW_HEIGHT * (row + 0.5)), (place, TOP + ROW_HEIGHT * (following + 0.5)), "joint")
