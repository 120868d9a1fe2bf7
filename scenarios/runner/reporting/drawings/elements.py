"""SVG elements. They stand inline in HTML and need no namespace; every text is escaped when it is written."""

from __future__ import annotations

import re
from collections.abc import Iterable
from xml.etree.ElementTree import Element, tostring

NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")

Point = tuple[float, float]


def element(name: str, *children: Element, text: str = "", **attributes: float | str) -> Element:
    """An element; `class_` and `aria_label` become class and aria-label, numbers are cut to a tenth."""
    made = Element(name, {_name(key): written(value) for key, value in attributes.items()})
    made.text = clean(text) or None
    made.extend(children)
    return made


def group(children: Iterable[Element], kind: str) -> Element:
    """Elements that belong together."""
    return element("g", *children, class_=kind)


def line(begin: Point, end: Point, kind: str) -> Element:
    """A straight line."""
    return element("line", x1=begin[0], y1=begin[1], x2=end[0], y2=end[1], class_=kind)


def polyline(points: Iterable[Point], kind: str) -> Element:
    """A line through points."""
    return element("polyline", points=joined(points), class_=kind)


def polygon(points: Iterable[Point], kind: str) -> Element:
    """An area."""
    return element("polygon", points=joined(points), class_=kind)


def rectangle(corner: Point, width: float, height: float, kind: str, hint: str = "") -> Element:
    """A rectangle by its upper left corner; `hint` is shown when a mouse rests on it."""
    children = [element("title", text=hint)] if hint else []
    return element("rect", *children, x=corner[0], y=corner[1], width=width, height=height, class_=kind)


def circle(centre: Point, radius: float, kind: str, hint: str = "") -> Element:
    """A dot."""
    children = [element("title", text=hint)] if hint else []
    return element("circle", *children, cx=centre[0], cy=centre[1], r=radius, class_=kind)


def label(place: Point, text: str, kind: str = "", anchor: str = "start") -> Element:
    """A text whose base line begins, ends or has its middle at a place."""
    return element("text", x=place[0], y=place[1], text=text, class_=kind or "label", text_anchor=anchor)


def written(value: float | str) -> str:
    """An attribute's value."""
    return clean(value) if isinstance(value, str) else f"{value:.1f}".removesuffix(".0")


def joined(points: Iterable[Point]) -> str:
    """Points as the attribute of a line."""
    return " ".join(f"{written(x)},{written(y)}" for x, y in points)


def clean(text: str) -> str:
    """A text without the characters that XML does not have."""
    return NOT_XML.sub("\ufffd", text)


def svg_text(root: Element) -> str:
    """The element and all below it."""
    return tostring(root, encoding="unicode")


def _name(key: str) -> str:
    return key.rstrip("_").replace("_", "-")
