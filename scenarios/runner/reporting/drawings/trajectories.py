"""Two vehicles from above while they meet: the routes that were played, the poses that were stored, and where both were
at each moment of the event.

Lengths are to one scale in both directions, unless the picture would be a mere line: then the narrow direction is
stretched, and its axis says so.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import dist, inf
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
    listed,
    picture,
)
from scenarios.runner.reporting.drawings.elements import Point, circle, label, line, polyline
from scenarios.runner.reporting.drawings.reading import Document, at, finite, rows
from scenarios.runner.reporting.drawings.scales import Scale, scale

ENCOUNTERS_MAX = 6
BEFORE_SECONDS, AFTER_SECONDS = 3.0, 2.0
HEIGHT_MIN, HEIGHT_MAX = 130.0, 300.0
SQUARE_M_MIN = 10.0
MARGIN = 22.0  # inside the axes, for marks
MARKS_APART = 17.0  # nearer ones have one label
LABELS_OF_NEAREST = (0.5, 0.36, 0.64, 0.22, 0.78)  # where it may stand, from the first vehicle to the second
LABELS_OF_EDGES = (0.22, 0.78, 0.36, 0.64, 0.5)
LABEL_WIDTH, LABEL_HEIGHT = 76.0, 11.0

Track = Sequence[tuple[float, ...]]  # seconds, x, y


@dataclass(frozen=True)
class Mark:
    """Moments at which a vehicle was at nearly the same place."""

    place: Point
    text: str


def trajectories(document: Document) -> Iterator[Drawing]:
    """One drawing per encounter, at most ENCOUNTERS_MAX; without encounters one of all that was played."""
    given = document["drawings"].get("trajectories") or {}
    tracks = {agent: _track(given.get("seconds"), track) for agent, track in (given.get("agents") or {}).items()}
    tracks = {agent: track for agent, track in tracks.items() if track}
    if not tracks:
        raise NoDrawingError("there are no trajectories in report.json")
    met = document["drawings"].get("encounters") or []
    for number, one in enumerate(met[:ENCOUNTERS_MAX], 1):
        mine = {agent: tracks[agent] for agent in one["agents"] if agent in tracks}
        if mine:
            yield _of_encounter(number, one, mine, given["agents"])
    if not met:
        yield _of_nobody(tracks)


def _track(seconds: object, track: Document) -> Track:
    return rows({**track, "seconds": seconds}, "seconds", "x_m", "y_m")


def _of_nobody(tracks: Mapping[str, Track]) -> Drawing:
    axes, height = _axes(tracks)
    parts = [axes.drawn(*_titles(axes)), *_paths(axes, tracks, "line")]
    title = "Trajectories from above: no encounter"
    key = tuple(KeyEntry(agent, f"s{number}") for number, agent in enumerate(tracks))
    return Drawing(title, picture("trajectories", title, f"Routes of {listed(list(tracks))}.", height, parts), key)


def _of_encounter(number: int, one: Document, tracks: Mapping[str, Track], given: Document) -> Drawing:
    moments = [(str(m["what"]), at) for m in one["moments"] if (at := finite(m["seconds"])) is not None]
    tracks = _while_they_meet(tracks, [seconds for _, seconds in moments], ended=bool(one.get("stop")))
    stored = {
        agent: _inside(_track(given[agent]["stored"]["seconds"], given[agent]["stored"]), tracks[agent])
        for agent in tracks
        if given[agent].get("stored")
    }
    axes, height = _axes(tracks)
    parts = [
        axes.drawn(*_titles(axes)),
        *_links(axes, one, tracks, [place for dots in _dots(axes, tracks, moments) for _, place in dots]),
        *_paths(axes, stored, "stored"),
        *_paths(axes, tracks, "line"),
        *(part for dots in _dots(axes, tracks, moments) for part in _marks(axes, dots)),
    ]
    title = f"Encounter {number} from above"
    picture_text = picture(f"trajectories-{number}", title, _description(one, tracks, moments), height, parts)
    return Drawing(title, picture_text, _key(tracks, moments, any(stored.values())))


def _while_they_meet(tracks: Mapping[str, Track], moments: Sequence[float], ended: bool) -> Mapping[str, Track]:
    """The time from a little before the first moment to a little after the last one; to the end of an event without
    one."""
    begin = min(moments, default=0.0) - BEFORE_SECONDS
    end = max(moments) + AFTER_SECONDS if moments and ended else inf
    return {agent: [row for row in track if begin <= row[0] <= end] or track for agent, track in tracks.items()}


def _inside(track: Track, other: Track) -> Track:
    return [row for row in track if other[0][0] <= row[0] <= other[-1][0]]


def _axes(tracks: Mapping[str, Track]) -> tuple[Axes, float]:
    """Both scales, and the height of the picture."""
    x = scale((row[1] for track in tracks.values() for row in track), LEFT + MARGIN, RIGHT - MARGIN, SQUARE_M_MIN)
    y = scale((row[2] for track in tracks.values() for row in track), 0.0, 1.0, SQUARE_M_MIN / 2)
    wanted = (y.high - y.low) * (x.end - x.begin) / (x.high - x.low)
    inner = min(max(wanted, HEIGHT_MIN - 2 * MARGIN), HEIGHT_MAX)
    bottom = TOP + inner + 2 * MARGIN
    if wanted > HEIGHT_MAX:  # one scale all the same: the picture becomes narrow
        middle, half = (x.low + x.high) / 2, (x.high - x.low) / 2 * wanted / HEIGHT_MAX
        x = Scale(middle - half, middle + half, x.begin, x.end)
    return Axes(_wider(x, LEFT, RIGHT), _wider(Scale(y.low, y.high, bottom - MARGIN, TOP + MARGIN), bottom, TOP)), (
        bottom + BOTTOM
    )


def _wider(inner: Scale, begin: float, end: float) -> Scale:
    """The same scale from `begin` to `end`."""
    per_unit = (inner.high - inner.low) / (inner.end - inner.begin)
    return Scale(inner.low + (begin - inner.begin) * per_unit, inner.high + (end - inner.end) * per_unit, begin, end)


def _titles(axes: Axes) -> tuple[str, str]:
    across = (axes.x.end - axes.x.begin) / (axes.x.high - axes.x.low)
    up = (axes.y.begin - axes.y.end) / (axes.y.high - axes.y.low)
    stretched = f", stretched {up / across:.0f} times" if up / across > 1.05 else ""
    return "x in m", f"y in m{stretched}"


def _paths(axes: Axes, tracks: Mapping[str, Track], kind: str) -> Iterator[Element]:
    for number, track in enumerate(tracks.values()):
        yield polyline((axes.place(x, y) for _, x, y in track), f"{kind} s{number}")
        if kind == "line" and track:
            yield circle(axes.place(*track[0][1:]), 2.5, f"begin s{number}", "begins here")


def _links(axes: Axes, one: Document, tracks: Mapping[str, Track], dots: Sequence[Point]) -> Iterator[Element]:
    """Lines between the two vehicles when the event starts, when they are nearest, and when it ends."""
    taken = [(dot, LABEL_WIDTH / 2) for dot in dots]
    for word, seconds, metres in _distances(one, tracks):
        ends = [at(track, seconds) for track in tracks.values()]
        if len(ends) == 2 and ends[0] and ends[1]:
            first, second = axes.place(*ends[0]), axes.place(*ends[1])
            yield line(first, second, "link")
            place = free_place(first, second, LABELS_OF_NEAREST if word == "nearest" else LABELS_OF_EDGES, taken)
            taken.append((place, LABEL_WIDTH))
            yield label((place[0], place[1] + 3.5), f"{word} {metres:.1f} m", "mark", "middle")


def free_place(first: Point, second: Point, shares: Sequence[float], taken: Sequence[tuple[Point, float]]) -> Point:
    """The first place on a line whose label covers none of those that are taken, each with a width; else the last."""
    places = [
        (first[0] + share * (second[0] - first[0]), first[1] + share * (second[1] - first[1])) for share in shares
    ]
    free = (
        (x, y)
        for x, y in places
        if not any(abs(x - other[0]) < width and abs(y - other[1]) < LABEL_HEIGHT for other, width in taken)
    )
    return next(free, places[-1])


def _distances(one: Document, tracks: Mapping[str, Track]) -> Iterator[tuple[str, float, float]]:
    """Words about when the vehicles were nearest, by their routes, and when the event starts and ends, by the
    detector."""
    near = nearest(list(tracks.values()))
    if near is not None:
        yield ("nearest", *near)
    for word in ("start", "stop"):
        edge = one.get(word) or {}
        seconds, metres = finite(edge.get("seconds")), finite(edge.get("distance_m"))
        if seconds is not None and metres is not None:
            yield word, seconds, metres


def nearest(tracks: Sequence[Track]) -> tuple[float, float] | None:
    """The time at which two tracks are nearest, and how near in m; None unless there are two with a common time."""
    if len(tracks) != 2:
        return None
    others = {row[0]: row[1:] for row in tracks[1]}
    together = [(dist(row[1:], others[row[0]]), row[0]) for row in tracks[0] if row[0] in others]
    metres, seconds = min(together, default=(None, None))
    return None if metres is None or seconds is None else (seconds, metres)


def _dots(
    axes: Axes, tracks: Mapping[str, Track], moments: Sequence[tuple[str, float]]
) -> list[list[tuple[int, Point]]]:
    """The dots of each vehicle, one where it was at each moment, with the moment's number."""
    return [
        [(n, axes.place(*where)) for n, (_, seconds) in enumerate(moments, 1) if (where := at(track, seconds))]
        for track in tracks.values()
    ]


def _marks(axes: Axes, dots: Sequence[tuple[int, Point]]) -> Iterator[Element]:
    """A dot for each moment, and a number for those that are apart, towards the nearer edge of the picture."""
    for _, place in dots:
        yield circle(place, 2.6, "dot")
    for mark in merged(dots):
        below = mark.place[1] > (axes.y.begin + axes.y.end) / 2
        yield label((mark.place[0], mark.place[1] + (14 if below else -7)), mark.text, "number", "middle")


def merged(dots: Sequence[tuple[int, Point]]) -> list[Mark]:
    """One label for successive dots that are too near each other for one each."""
    groups: list[list[tuple[int, Point]]] = []
    for dot in dots:
        if groups and dist(groups[-1][0][1], dot[1]) < MARKS_APART:
            groups[-1].append(dot)
        else:
            groups.append([dot])
    return [
        Mark(
            (sum(place[0] for _, place in group) / len(group), sum(place[1] for _, place in group) / len(group)),
            str(group[0][0]) if len(group) == 1 else f"{group[0][0]}-{group[-1][0]}",
        )
        for group in groups
    ]


def _description(one: Document, tracks: Mapping[str, Track], moments: Sequence[tuple[str, float]]) -> str:
    lengths = ", ".join(
        f"{word} {metres:.1f} m at {seconds:.1f} s" for word, seconds, metres in _distances(one, tracks)
    )
    words = ", ".join(f"{what} at {seconds:.1f} s" for what, seconds in moments)
    return f"Routes of {listed(list(tracks))}. Distances: {lengths}. Moments: {words}."


def _key(tracks: Mapping[str, Track], moments: Sequence[tuple[str, float]], stored: bool) -> tuple[KeyEntry, ...]:
    agents = [KeyEntry(agent, f"s{number}") for number, agent in enumerate(tracks)]
    thick = [KeyEntry("poses that were stored", "stored")] if stored else []
    numbered = [
        KeyEntry(f"{what}, {seconds:.1f} s", mark=str(number)) for number, (what, seconds) in enumerate(moments, 1)
    ]
    return (*agents, *thick, *numbered)
