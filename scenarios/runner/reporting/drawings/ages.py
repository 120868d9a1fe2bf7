"""Pose ages: how old the poses were when they reached the event detector, and which vehicle's were old when."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from math import ceil
from xml.etree.ElementTree import Element

from scenarios.runner.reporting.drawings.drawing import (
    BOTTOM,
    LEFT,
    RIGHT,
    TOP,
    Axes,
    Drawing,
    KeyEntry,
    NoDrawingError,
    picture,
    shortened,
)
from scenarios.runner.reporting.drawings.elements import label, line, polygon, polyline, rectangle
from scenarios.runner.reporting.drawings.reading import Document, finite, rows
from scenarios.runner.reporting.drawings.scales import Scale, number, scale, step_of, upwards

HEIGHT = 230.0
BARS_MAX = 60
SHOWN_SHARE = 0.999
LONGEST_MS = 1000.0  # what the detector counts as this may be older
BREAK = 1.5  # of the usual distance between two values
ROW_HEIGHT, ROWS_MAX, ROWS_LEFT = 22.0, 20, 66.0

Quantiles = Sequence[tuple[float, ...]]  # seconds, p50, p99


def ages(document: Document) -> Iterator[Drawing]:
    """The distribution, and a row per vehicle."""
    given = document["drawings"].get("pose_ages") or {}
    counted = [row for row in rows(given, "milliseconds", "poses") if row[1] > 0]
    if not counted:
        raise NoDrawingError("there are no pose ages in report.json, or no pose came")
    yield _distribution(document, counted)
    vehicles = {
        agent: quantiles
        for agent, one in (given.get("vehicles") or {}).items()
        if (quantiles := rows(one, "seconds", "p50_ms", "p99_ms"))
    }
    if not vehicles:
        raise NoDrawingError("over time: report.json has no ages by second, which older event detectors do not offer")
    yield _over_time(vehicles)


def _distribution(document: Document, counted: Sequence[tuple[float, ...]]) -> Drawing:
    total = sum(poses for _, poses in counted)
    marks = list(_marks(document, counted, total))
    longest = max(quantile(counted, SHOWN_SHARE), *(age for _, age in marks))
    width = max(1.0, step_of((longest + 1) / BARS_MAX))
    bars = _bars(counted, width, longest)
    axes = Axes(
        Scale(0.0, max(age for age, _ in bars) + width, LEFT, RIGHT),
        upwards((100 * poses / total for _, poses in bars), HEIGHT - BOTTOM, TOP),
    )
    parts = [
        axes.drawn("age in ms", f"% of poses per {width:g} ms"),
        *(_bar(axes, age, width, 100 * poses / total) for age, poses in bars),
        *(part for row, (word, age) in enumerate(marks) for part in _mark(axes, word, age, row)),
    ]
    beyond = sum(poses for age, poses in counted if age > longest)
    text = f"{total:.0f} poses of all vehicles; {beyond:.0f} are older than shown, the oldest {_oldest(counted)}"
    title = "Pose age: distribution"
    values = ", ".join(f"{word} {age:g} ms" for word, age in marks)
    return Drawing(title, picture("ages", title, f"{text}. {values}.", HEIGHT, parts), (KeyEntry(text),))


def quantile(counted: Sequence[tuple[float, ...]], share: float) -> float:
    """The upper edge in ms of the bucket that `share` of the poses do not exceed."""
    needed = ceil(share * sum(poses for _, poses in counted))
    reached = 0.0
    for age, poses in sorted(counted):
        reached += poses
        if reached >= needed:
            return age + 1
    return 0.0


def _marks(document: Document, counted: Sequence[tuple[float, ...]], total: float) -> Iterator[tuple[str, float]]:
    yield "p50", quantile(counted, 0.5)
    yield "p99", quantile(counted, 0.99)
    for row in document["expectations"]:
        if row["name"] == "pose_age_p99_seconds":
            bound = finite(_number(str(row["expected"])))
            if bound is not None and 1000 * bound <= LONGEST_MS:
                yield "bound of p99", 1000 * bound


def _number(expected: str) -> float | None:
    try:
        return float(expected.split()[-1])
    except (ValueError, IndexError):
        return None


def _bars(counted: Sequence[tuple[float, ...]], width: float, longest: float) -> list[tuple[float, float]]:
    """Lower edges and poses of bars of one width, those that are shown."""
    bars = {0.0: 0.0, longest // width * width: 0.0}
    for age, poses in counted:
        if age <= longest:
            edge = age // width * width
            bars[edge] = bars.get(edge, 0.0) + poses
    return sorted(bars.items())


def _bar(axes: Axes, age: float, width: float, percent: float) -> Element:
    (left, top), (right, bottom) = axes.place(age, percent), axes.place(age + width, 0.0)
    hint = f"{age:g} to {age + width:g} ms: {percent:.2f} %"
    return rectangle((left, top), max(right - left - 0.4, 0.4), bottom - top, "bar0", hint)


def _mark(axes: Axes, word: str, age: float, row: int) -> Iterator[Element]:
    place = axes.x.inside(age)
    yield line((place, axes.y.begin), (place, axes.y.end), "threshold")
    right = place > (LEFT + RIGHT) / 2
    text = f"{word} {number(age)} ms"
    yield label(
        (place - 3 if right else place + 3, axes.y.end + 10 + 14 * row), text, "mark", "end" if right else "start"
    )


def _oldest(counted: Sequence[tuple[float, ...]]) -> str:
    oldest = max(age for age, _ in counted)
    return "1 s or more" if oldest >= LONGEST_MS else f"{oldest + 1:.0f} ms"


def _over_time(vehicles: Mapping[str, Quantiles]) -> Drawing:
    """p99 as an area and p50 as a line, a row per vehicle, all on one scale."""
    oldest = {agent: max(p99 for _, _, p99 in one) for agent, one in vehicles.items()}
    shown = sorted(sorted(vehicles, key=lambda agent: -oldest[agent])[:ROWS_MAX])
    most = max(1.0, max(oldest.values()))
    bottom = TOP + ROW_HEIGHT * len(shown)
    across = scale((row[0] for vehicle in vehicles.values() for row in vehicle), ROWS_LEFT, RIGHT - 42)
    parts = [Axes(across, Scale(0.0, 1.0, bottom, TOP)).drawn("seconds since the start", "")]
    for number_, agent in enumerate(shown):
        floor = TOP + ROW_HEIGHT * (number_ + 1)
        row = Axes(across, Scale(0.0, most, floor, floor - ROW_HEIGHT + 3))
        parts += _row(row, agent, vehicles[agent], oldest[agent])
    parts.append(label((RIGHT, TOP - 6), "greatest p99", "unit", "end"))
    left_out = (
        f"; {len(vehicles) - len(shown)} vehicles with younger poses are left out" if len(shown) < len(vehicles) else ""
    )
    text = f"each row is {most:.0f} ms high{left_out}"
    title = "Pose age: per vehicle over time"
    values = ", ".join(f"{agent} {oldest[agent]:.0f} ms" for agent in shown)
    svg = picture("ages-over-time", title, f"Greatest p99 of a second: {values}.", bottom + BOTTOM, parts)
    return Drawing(title, svg, (KeyEntry("p99 of a second", "area"), KeyEntry("p50", "middle"), KeyEntry(text)))


def unbroken(one: Quantiles) -> list[Quantiles]:
    """The stretches between times in which no pose came."""
    usual = min((after[0] - before[0] for before, after in pairwise(one)), default=0.0)
    breaks = [n for n, (before, after) in enumerate(pairwise(one), 1) if after[0] - before[0] > BREAK * usual]
    return [one[begin:end] for begin, end in pairwise([0, *breaks, len(one)])]


def _row(axes: Axes, agent: str, one: Quantiles, oldest: float) -> Iterator[Element]:
    floor = axes.y.begin
    yield line((axes.x.begin, floor), (axes.x.end, floor), "base")
    for run in unbroken(one):
        tops = [axes.place(seconds, p99) for seconds, _, p99 in run]
        yield polygon([(tops[0][0], floor), *tops, (tops[-1][0], floor)], "area")
        yield polyline((axes.place(seconds, p50) for seconds, p50, _ in run), "middle")
    yield label((ROWS_LEFT - 5, floor - 4), shortened(agent, ROWS_LEFT - 8), "label", "end")
    yield label((RIGHT, floor - 4), f"{oldest:.0f} ms", "tick", "end")
