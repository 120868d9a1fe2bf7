"""Distance over time of each pair that met, with the thresholds of the rule and what the event detector measured."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from math import dist
from xml.etree.ElementTree import Element

from scenarios.runner.reporting.drawings.drawing import (
    BOTTOM,
    COLOURS,
    LEFT,
    RIGHT,
    TOP,
    Axes,
    Drawing,
    KeyEntry,
    NoDrawingError,
    bands,
    picture,
)
from scenarios.runner.reporting.drawings.elements import circle, label, line, polyline
from scenarios.runner.reporting.drawings.reading import Document, finite, rows
from scenarios.runner.reporting.drawings.scales import number, scale, upwards

HEIGHT = 230.0
PAIRS_MAX = 6

Line = Sequence[tuple[float, float]]


def distances(document: Document) -> Iterator[Drawing]:
    """One drawing of all pairs."""
    lines = _lines(document)
    if not lines:
        raise NoDrawingError("there are no trajectories of two vehicles in report.json")
    thresholds = list(_thresholds(document["parameters"]))
    axes = Axes(
        scale((seconds for one in lines.values() for seconds, _ in one), LEFT, RIGHT),
        upwards(
            [metres for one in lines.values() for _, metres in one] + [metres for _, metres in thresholds],
            HEIGHT - BOTTOM,
            TOP,
        ),
    )
    met = document["drawings"].get("encounters") or []
    parts = [
        *bands(axes, _spans(met, axes)),
        axes.drawn("seconds since the start", "distance in m"),
        *_threshold_lines(axes, thresholds),
        *(polyline((axes.place(*point) for point in one), f"line s{n}") for n, one in enumerate(lines.values())),
        *_edges(axes, met),
    ]
    title = "Distance over time"
    yield Drawing(title, picture("distances", title, _description(lines, met), HEIGHT, parts), _key(lines, met))


def _lines(document: Document) -> Mapping[str, Line]:
    """The lines of distances by pair; of the pairs that met, or of all when none did."""
    given = document["drawings"].get("trajectories") or {}
    tracks = {}
    for agent, track in (given.get("agents") or {}).items():
        places = rows({**track, "seconds": given.get("seconds")}, "seconds", "x_m", "y_m")
        tracks[agent] = {seconds: (x, y) for seconds, x, y in places}
    met = {tuple(sorted(one["agents"])) for one in document["drawings"].get("encounters") or []}
    pairs = sorted(pair for pair in met if len(pair) == 2) or list(combinations(sorted(tracks), 2))
    lines = {
        f"{one} and {other}": [
            (seconds, dist(place, tracks[other][seconds]))
            for seconds, place in tracks[one].items()
            if seconds in tracks[other]
        ]
        for one, other in pairs
        if one in tracks and other in tracks
    }
    return dict([(pair, one) for pair, one in lines.items() if one][:PAIRS_MAX])


def _thresholds(parameters: Document) -> Iterator[tuple[str, float]]:
    """Of the rule; a story without encounters has none."""
    if not parameters.get("encounters"):
        return
    for word in ("start", "stop"):
        metres = finite(parameters.get(f"{word}_distance_m"))
        if metres is not None:
            yield word, metres


def _threshold_lines(axes: Axes, thresholds: Sequence[tuple[str, float]]) -> Iterator[Element]:
    for word, metres in thresholds:
        yield line(axes.place(axes.x.low, metres), axes.place(axes.x.high, metres), "threshold")
        place = axes.place(axes.x.high, metres)
        yield label((place[0] - 2, place[1] - 3), f"{word} {number(metres)} m", "mark", "end")


def _spans(met: Sequence[Document], axes: Axes) -> Iterator[tuple[float, float]]:
    for one in met:
        begin, end = finite(one["start"]["seconds"]), finite((one["stop"] or {}).get("seconds"))
        if begin is not None:
            yield begin, axes.x.high if end is None else end


def _edges(axes: Axes, met: Sequence[Document]) -> Iterator[Element]:
    """What the event detector measured when it raised and ended the event."""
    for one in met:
        for edge, word in ((one["start"], "starts"), (one["stop"], "ends")):
            seconds, metres = (finite((edge or {}).get(name)) for name in ("seconds", "distance_m"))
            if seconds is not None and metres is not None:
                hint = f"event {word} at {seconds:.3f} s, {metres:.1f} m"
                yield circle(axes.place(seconds, metres), 3.2, "dot", hint)


def _description(lines: Mapping[str, Line], met: Sequence[Document]) -> str:
    nearest = "; ".join(f"{pair}: nearest {min(metres for _, metres in one):.1f} m" for pair, one in lines.items())
    return f"{nearest}. Encounters: {len(met)}."


def _key(lines: Mapping[str, Line], met: Sequence[Document]) -> tuple[KeyEntry, ...]:
    pairs = [KeyEntry(pair, f"s{number % COLOURS}") for number, pair in enumerate(lines)]
    measured = [KeyEntry("measured by the event detector", "dot"), KeyEntry("event lasts", "band")] if met else []
    return (*pairs, *measured)
