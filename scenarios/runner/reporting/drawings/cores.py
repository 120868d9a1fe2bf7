"""Cores over time: what each component took, one upon the other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
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
    picture,
)
from scenarios.runner.reporting.drawings.elements import Point, label, line, polygon
from scenarios.runner.reporting.drawings.reading import Document, finite
from scenarios.runner.reporting.drawings.scales import scale, upwards

HEIGHT = 250.0

Span = tuple[float, float]


def cores(document: Document) -> Iterator[Drawing]:
    """One drawing of all components."""
    given = document["drawings"].get("cores") or {}
    times = [finite(value) for value in given.get("seconds") or ()]
    bounds = [value for value in times if value is not None]
    components = {name: [finite(value) or 0.0 for value in values] for name, values in _named(given)}
    if len(bounds) < 2 or len(bounds) != len(times) or not components:
        raise NoDrawingError("there are no cores over time in report.json")
    spans = list(pairwise(bounds))
    layers = _layers(components, len(spans))
    axes = Axes(scale(bounds, LEFT, RIGHT), upwards(layers[-1], HEIGHT - BOTTOM, TOP, 0.1))
    parts = [
        axes.drawn("seconds since the start", "cores"),
        *(
            polygon([*_steps(axes, spans, above), *reversed(list(_steps(axes, spans, below)))], f"layer s{n % COLOURS}")
            for n, (below, above) in enumerate(pairwise(layers))
        ),
        *_events(axes, document["drawings"].get("encounters") or []),
    ]
    title = "Cores over time"
    svg = picture("cores", title, _description(components, spans, layers[-1]), HEIGHT, parts)
    yield Drawing(title, svg, tuple(KeyEntry(name, f"s{n % COLOURS}") for n, name in enumerate(components)))


def _named(given: Document) -> Iterator[tuple[str, Sequence[object]]]:
    for name, values in (given.get("components") or {}).items():
        if values:
            yield str(name), values


def _layers(components: Mapping[str, Sequence[float]], length: int) -> list[list[float]]:
    """The sums below and above each component."""
    layers = [[0.0] * length]
    for values in components.values():
        padded = [*values, *[0.0] * length]
        layers.append([below + max(0.0, padded[n]) for n, below in enumerate(layers[-1])])
    return layers


def _steps(axes: Axes, spans: Sequence[Span], values: Sequence[float]) -> Iterator[Point]:
    for (begin, end), value in zip(spans, values, strict=True):
        yield axes.place(begin, value)
        yield axes.place(end, value)


def _events(axes: Axes, met: Sequence[Document]) -> Iterator[Element]:
    """A line at each event and at its end."""
    for number, one in enumerate(met, 1):
        for edge, word in ((one["start"], "event"), (one["stop"], "ends")):
            seconds = finite((edge or {}).get("seconds"))
            if seconds is None:
                continue
            place = axes.x.inside(seconds)
            yield line((place, axes.y.begin), (place, axes.y.end), "event")
            yield label((place + 2, axes.y.end - 2), f"{word} {number}", "mark")


def _description(components: Mapping[str, Sequence[float]], spans: Sequence[Span], total: Sequence[float]) -> str:
    seconds = spans[-1][1] - spans[0][0]
    spent = {
        name: sum(value * (end - begin) for value, (begin, end) in zip(values, spans, strict=False))
        for name, values in components.items()
    }
    averages = ", ".join(f"{name} {core_seconds / seconds:.2f}" for name, core_seconds in spent.items())
    return f"At most {max(total):.2f} cores together. On average: {averages}."
