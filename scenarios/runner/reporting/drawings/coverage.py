"""Recordings: a bar from the first to the last message of each topic, the window in which nothing may be missing, and
the gaps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
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
from scenarios.runner.reporting.drawings.scales import Scale, scale

RECORDINGS_MAX = 12
NAMES, TOP, ROW_HEIGHT, BAR_HEIGHT = 150.0, 4.0, 16.0, 10.0
GAP_WIDTH_MIN = 1.5

Span = tuple[float, float]


@dataclass(frozen=True)
class Recorded:
    """A recording: its window, and its topics with their spans and gaps in s."""

    title: str
    window: Span | None
    topics: tuple[tuple[Document, Span | None, tuple[Span, ...]], ...]

    @property
    def rows(self) -> int:
        """Its title, and a row per topic."""
        return 1 + len(self.topics)


def coverage(document: Document) -> Iterator[Drawing]:
    """One drawing of all recordings, at most RECORDINGS_MAX."""
    given = document["drawings"].get("recordings") or []
    shown = [_recorded(number, one) for number, one in enumerate(given[:RECORDINGS_MAX], 1)]
    if not any(span for one in shown for _, span, _ in one.topics):
        raise NoDrawingError("there are no recorded messages in report.json")
    bottom = TOP + ROW_HEIGHT * sum(one.rows for one in shown)
    axes = Axes(scale(_times(shown), NAMES, RIGHT - 34), Scale(0.0, 1.0, bottom, TOP))
    parts = [axes.drawn("seconds since the start, by source stamps", "")]
    row = 0
    for one in shown:
        parts += _rows(axes, row, one)
        row += one.rows
    title = "Recordings: windows and gaps"
    gaps = sum(int(finite(topic.get("gaps_total")) or 0) for one in shown for topic, _, _ in one.topics)
    text = f"{len(given)} recordings, {gaps} gaps"
    more = [KeyEntry(f"the first {RECORDINGS_MAX} of {len(given)} recordings")] if len(given) > len(shown) else []
    key = (KeyEntry("messages", "recorded"), KeyEntry("window", "window"), KeyEntry(f"gaps: {gaps}", "gap"), *more)
    yield Drawing(title, picture("recordings", title, f"{text}. {_words(shown)}", bottom + BOTTOM, parts), key)


def _recorded(number: int, one: Document) -> Recorded:
    window = _span(one.get("window"))
    lost = one.get("lost")
    length = f"window {window[1] - window[0]:.1f} s" if window else "no window"
    title = f"recording {number}: {length}, lost {'not known' if lost is None else lost}"
    return Recorded(
        title,
        window,
        tuple(
            (topic, _span([topic.get("first"), topic.get("last")]), tuple(filter(None, map(_span, topic["gaps"]))))
            for topic in one["topics"]
        ),
    )


def _span(given: Sequence[object] | None) -> Span | None:
    begin, end = (finite(value) for value in given or (None, None))
    return None if begin is None or end is None or begin > end else (begin, end)


def _times(shown: Sequence[Recorded]) -> Iterator[float]:
    for one in shown:
        yield from one.window or ()
        for _, span, _ in one.topics:
            yield from span or ()


def _rows(axes: Axes, row: int, one: Recorded) -> Iterator[Element]:
    top = TOP + ROW_HEIGHT * row
    yield label((0, top + 12), one.title, "heading")
    if one.window:
        left, right = (axes.x(value) for value in one.window)
        height = ROW_HEIGHT * len(one.topics)
        yield rectangle((left, top + ROW_HEIGHT), max(right - left, 0.5), height, "window", one.title)
    for number, (topic, span, gaps) in enumerate(one.topics, 1):
        yield from _topic(axes, top + ROW_HEIGHT * number + (ROW_HEIGHT - BAR_HEIGHT) / 2, topic, span, gaps)


def _topic(axes: Axes, top: float, topic: Document, span: Span | None, gaps: Sequence[Span]) -> Iterator[Element]:
    name = f"{topic['agent']} {topic['what']}"
    yield label((8, top + 8.5), shortened(name, NAMES - 8), "label")
    yield line((NAMES, top + BAR_HEIGHT / 2), (axes.x.end, top + BAR_HEIGHT / 2), "base")
    yield label((RIGHT, top + 8.5), f"{topic['messages']}", "tick", "end")
    if span:
        left, right = axes.x(span[0]), axes.x(span[1])
        yield rectangle((left, top), max(right - left, 1.0), BAR_HEIGHT, "recorded", f"{name}: {topic['messages']}")
    for begin, end in gaps:
        left = axes.x(begin)
        width = max(axes.x(end) - axes.x(begin), GAP_WIDTH_MIN)
        yield rectangle((left, top - 1), width, BAR_HEIGHT + 2, "gap", f"nothing from {begin:.3f} to {end:.3f} s")


def _words(shown: Sequence[Recorded]) -> str:
    return " ".join(
        f"{one.title}: "
        + ", ".join(f"{topic['messages']} {topic['what']} of {topic['agent']}" for topic, _, _ in one.topics)
        + "."
        for one in shown
    )
