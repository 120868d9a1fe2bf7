"""What a drawing is, and the frame of its picture: all are 400 units wide, which is legible at 360 pixels and at
1200."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element

from scenarios.runner.reporting.drawings.elements import Point, element, group, label, line, svg_text
from scenarios.runner.reporting.drawings.scales import Scale, number

WIDTH = 400.0
LEFT, RIGHT, TOP, BOTTOM = 40.0, 386.0, 18.0, 34.0
TEXT_UNITS = 5.8  # of a character, on average
COLOURS = 8


class NoDrawingError(Exception):
    """There is no drawing; the message says why, for the reader of the report."""


@dataclass(frozen=True)
class KeyEntry:
    """What a mark of the picture means: a `colour` (a class of the style sheet) or a `mark` in it."""

    text: str
    colour: str = ""
    mark: str = ""


@dataclass(frozen=True)
class Drawing:
    """A picture with its caption and key."""

    caption: str
    svg: str
    key: tuple[KeyEntry, ...] = field(default=())


@dataclass(frozen=True)
class Axes:
    """The two scales of a picture."""

    x: Scale
    y: Scale

    def place(self, x: float, y: float) -> Point:
        """The place of a value; beyond the scales: at their ends."""
        return self.x.inside(x), self.y.inside(y)

    def drawn(self, x_title: str, y_title: str) -> Element:
        """Lines at the ticks, their values, and what is measured in which unit."""
        return group([*_across(self, x_title), *_up(self, y_title)], "axes")


def picture(name: str, title: str, description: str, height: float, parts: Iterable[Element]) -> str:
    """The SVG of a drawing, with what a screen reader says of it; `name` is unique in a page."""
    ids = f"{name}-title", f"{name}-description"
    root = element(
        "svg",
        element("title", text=title, id=ids[0]),
        element("desc", text=description, id=ids[1]),
        *parts,
        role="img",
        aria_labelledby=" ".join(ids),
        viewBox=f"0 0 {WIDTH:g} {height:.0f}",
        class_="drawing",
    )
    return svg_text(root)


def _across(axes: Axes, title: str) -> Iterable[Element]:
    bottom = axes.y.begin
    for tick in axes.x.ticks():
        yield line((axes.x(tick), axes.y.end), (axes.x(tick), bottom), "grid")
        yield label((axes.x(tick), bottom + 12), number(tick), "tick", "middle")
    yield label((axes.x.end, bottom + 26), title, "unit", "end")


def _up(axes: Axes, title: str) -> Iterable[Element]:
    if not title:
        return
    for tick in axes.y.ticks(5):
        yield line((axes.x.begin, axes.y(tick)), (axes.x.end, axes.y(tick)), "grid")
        yield label((axes.x.begin - 4, axes.y(tick) + 3.5), number(tick), "tick", "end")
    yield label((2, axes.y.end - 8), title, "unit")


def bands(axes: Axes, spans: Iterable[tuple[float, float]]) -> Iterable[Element]:
    """Times over the whole height: encounters."""
    for begin, end in spans:
        left, right = axes.x.inside(begin), axes.x.inside(end)
        yield element("rect", x=left, y=axes.y.end, width=right - left, height=axes.y.begin - axes.y.end, class_="band")


def shortened(text: str, units: float) -> str:
    """A text that fits."""
    room = max(1, int(units / TEXT_UNITS))
    return text if len(text) <= room else text[: room - 1] + "…"


def listed(names: Sequence[str]) -> str:
    """Names as words."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
