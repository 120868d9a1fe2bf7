"""The drawings of a report stand where the data are: places are read back from the picture by the ticks of its axes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from math import nan
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, fromstring

import pytest

from scenarios.runner.reporting.drawings import ages, cores, coverage, distances, trajectories, ways
from scenarios.runner.reporting.drawings.drawing import Drawing, NoDrawingError, shortened
from scenarios.runner.reporting.drawings.gallery import DRAWINGS, OLDER, gallery
from scenarios.runner.reporting.drawings.reading import at, finite, rows
from scenarios.runner.reporting.drawings.scales import Scale, step_of

Place = tuple[float, float]
TENTH = 0.051  # of a unit: how exactly places are written

ONE, OTHER = "vehicle-00", "vehicle-01"
TRACKS = {
    ONE: {"x_m": [0.0, 30.0, 60.0, 90.0, 120.0], "y_m": [0.0, 0.0, 30.0, 60.0, 90.0]},
    OTHER: {"x_m": [120.0, 90.0, 60.0, 60.0, 60.0], "y_m": [90.0, 90.0, 90.0, 60.0, 0.0]},
}
STORED = {"seconds": [1.0, 2.0, 3.0], "x_m": [30.0, 60.0, 90.0], "y_m": [0.0, 30.0, 60.0]}
ENCOUNTER = {
    "event": "e1",
    "rule": "near",
    "agents": [ONE, OTHER],
    "start": {"seconds": 1.0, "distance_m": 108.2},
    "stop": {"seconds": 3.5, "distance_m": 75.0},
    "moments": [{"what": "event", "seconds": 1.0}, {"what": "first point cloud stored", "seconds": 2.5}],
    "deployment": [
        {"step": "detection", "begin": 1.0, "end": 1.5, "critical": True},
        {"step": "gate", "begin": 1.5, "end": 3.0, "critical": True},
        {"step": "plan observed", "begin": 1.5, "end": 2.0, "critical": False},
    ],
    "removal": [{"step": "pods going", "begin": 3.5, "end": 4.0, "critical": True}],
}
RECORDING = {
    "event": "e1",
    "window": [2.0, 3.5],
    "lost": 2,
    "topics": [
        {"agent": ONE, "what": "poses", "messages": 140, "first": 1.5, "last": 4.0, "gaps": [], "gaps_total": 0},
        {"agent": ONE, "what": "point clouds", "messages": 13, "first": 2.0, "last": 3.5, "gaps": [[2.5, 2.8]],
         "gaps_total": 1},
        {"agent": OTHER, "what": "poses", "messages": 0, "first": None, "last": None, "gaps": [[2.0, 3.5]],
         "gaps_total": 1},
    ],
}  # fmt: skip
DOCUMENT: dict[str, Any] = {
    "parameters": {"encounters": 1, "start_distance_m": 110, "stop_distance_m": 140},
    "expectations": [{"name": "pose_age_p99_seconds", "expected": "<= 0.05"}],
    "drawings": {
        "encounters": [ENCOUNTER],
        "trajectories": {
            "seconds": [0.0, 1.0, 2.0, 3.0, 4.0],
            "agents": {
                ONE: {**TRACKS[ONE], "stored": STORED},
                OTHER: {**TRACKS[OTHER], "stored": {"seconds": [], "x_m": [], "y_m": []}},
            },
        },
        "pose_ages": {
            "milliseconds": [5, 6, 30],
            "poses": [60, 39, 1],
            "vehicles": {
                ONE: {"seconds": [0, 1, 2, 6], "p50_ms": [10, 10, 20, 10], "p99_ms": [20, 40, 80, 20]},
                OTHER: {"seconds": [0, 1, 2, 3], "p50_ms": [5, 5, 5, 5], "p99_ms": [8, 8, 8, 40]},
            },
        },
        "cores": {
            "seconds": [-1.0, 0.0, 2.0, 4.0],
            "components": {"kubelet": [0.5, 1.0, 0.5], "broker": [0.25, 0.25, 1.0]},
        },
        "recordings": [RECORDING],
    },
}


def changed(**drawings: Any) -> dict[str, Any]:
    document = deepcopy(DOCUMENT)
    document["drawings"] |= drawings
    return document


class Picture(NamedTuple):
    """A drawing as its elements, with the axes that its ticks state."""

    root: Element

    def of(self, kind: str, tag: str | None = None) -> list[Element]:
        return [
            one for one in self.root.iter() if kind in one.get("class", "").split() and (tag is None or one.tag == tag)
        ]

    def texts(self, kind: str) -> list[str]:
        return [one.text or "" for one in self.of(kind)]

    def x(self, place: float) -> float:
        return self._value(place, "x", "middle")

    def y(self, place: float) -> float:
        return self._value(place, "y", "end", 3.5)

    def value(self, place: Place) -> Place:
        return self.x(place[0]), self.y(place[1])

    def _value(self, place: float, axis: str, anchor: str, above: float = 0.0) -> float:
        ticks = [
            (float(one.get(axis, "")) - above, float(one.text or "")) for one in self.of("tick") if _plain(one, anchor)
        ]
        (begin, low), (end, high) = ticks[0], ticks[-1]
        return low + (place - begin) / (end - begin) * (high - low)


def _plain(tick: Element, anchor: str) -> bool:
    """Return whether it is an axis's tick, and no value beside a bar."""
    return tick.get("text-anchor") == anchor and " " not in (tick.text or "") and tick.get("x") != "386"


def picture(drawing: Drawing) -> Picture:
    return Picture(fromstring(drawing.svg))  # noqa: S314 - made here


def points(element: Element) -> list[Place]:
    pairs = (pair.split(",") for pair in element.get("points", "").split())
    return [(float(x), float(y)) for x, y in pairs]


def corner(element: Element) -> tuple[float, float, float]:
    """Left, right and top of a rectangle."""
    left, width = float(element.get("x", "")), float(element.get("width", ""))
    return left, left + width, float(element.get("y", ""))


def centre(element: Element) -> Place:
    return float(element.get("cx", "")), float(element.get("cy", ""))


def near(expected: Any, tolerance: float) -> Any:
    return pytest.approx(expected, abs=tolerance)


# distances ------------------------------------------------------------------------------------------------------------


def test_the_distance_stands_at_its_time_with_the_thresholds_and_what_the_detector_measured() -> None:
    (drawing,) = distances.distances(DOCUMENT)
    seen = picture(drawing)
    (line,) = seen.of("line", "polyline")
    measured = [seen.value(point) for point in points(line)]
    assert [seconds for seconds, _ in measured] == near([0, 1, 2, 3, 4], 0.01)
    assert [metres for _, metres in measured] == near([150.0, 108.17, 60.0, 30.0, 108.17], 0.3)
    assert [seen.y(float(one.get("y1", ""))) for one in seen.of("threshold")] == near([110, 140], 0.3)
    assert seen.texts("mark") == ["start 110 m", "stop 140 m"]
    dots = [seen.value(centre(dot)) for dot in seen.of("dot", "circle")]
    assert dots[0] == near((1.0, 108.2), 0.3)
    assert dots[1] == near((3.5, 75.0), 0.3)
    (band,) = seen.of("band")
    assert [seen.x(place) for place in corner(band)[:2]] == near([1.0, 3.5], 0.01)


def test_an_event_without_an_end_lasts_to_the_end_of_the_picture() -> None:
    (drawing,) = distances.distances(changed(encounters=[{**ENCOUNTER, "stop": None}]))
    seen = picture(drawing)
    assert [seen.x(place) for place in corner(seen.of("band")[0])[:2]] == near([1.0, 4.0], 0.01)
    assert len(seen.of("dot", "circle")) == 1


# trajectories ---------------------------------------------------------------------------------------------------------


def test_vehicles_are_seen_from_above_on_one_scale() -> None:
    (drawing,) = trajectories.trajectories(DOCUMENT)
    seen = picture(drawing)
    for line, track in zip(seen.of("line", "polyline"), TRACKS.values(), strict=True):
        places = [seen.value(point) for point in points(line)]
        assert [x for x, _ in places] == near(track["x_m"], 0.3)
        assert [y for _, y in places] == near(track["y_m"], 0.3)
    assert seen.x(100) - seen.x(0) == near(seen.y(0) - seen.y(100), 0.3)
    assert seen.texts("unit") == ["x in m", "y in m"]
    stored = seen.of("stored", "polyline")[0]
    assert [seen.value(point)[0] for point in points(stored)] == near(STORED["x_m"], 0.3)


def test_both_vehicles_are_marked_at_each_moment_and_joined_at_start_nearest_and_stop() -> None:
    (drawing,) = trajectories.trajectories(DOCUMENT)
    seen = picture(drawing)
    dots = [seen.value(centre(dot)) for dot in seen.of("dot", "circle")]
    for dot, place in zip(dots, [(30, 0), (75, 45), (90, 90), (60, 75)], strict=True):
        assert dot == near(place, 0.4)
    ends = [
        (seen.value((float(one.get("x1", "")), float(one.get("y1", "")))), float(one.get("x2", "")))
        for one in seen.of("link")
    ]
    for (place, other), (first, second) in zip(ends, [((90, 60), 60), ((30, 0), 90), ((105, 75), 60)], strict=True):
        assert place == near(first, 0.4)
        assert seen.x(other) == near(second, 0.4)
    assert seen.texts("mark") == ["nearest 30.0 m", "start 108.2 m", "stop 75.0 m"]
    assert [entry.text for entry in drawing.key if entry.mark] == ["event, 1.0 s", "first point cloud stored, 2.5 s"]


def test_a_drive_on_one_road_is_stretched_and_says_so() -> None:
    document = changed()
    for track, lane in zip(document["drawings"]["trajectories"]["agents"].values(), (-4.0, 4.0), strict=True):
        track |= {"x_m": [500.0 * x for x in range(5)], "y_m": [lane] * 5}
    (drawing,) = trajectories.trajectories(document)
    seen = picture(drawing)
    assert {round(seen.value(point)[1], 1) for line in seen.of("line", "polyline") for point in points(line)} == {-4, 4}
    across, up = (seen.x(100) - seen.x(0)) / 100, (seen.y(0) - seen.y(100)) / 100
    assert seen.texts("unit")[1] == f"y in m, stretched {across / up:.0f} times"


def test_a_drive_north_is_as_true_to_scale_as_one_east() -> None:
    document = changed()
    for track in document["drawings"]["trajectories"]["agents"].values():
        track |= {"x_m": track["y_m"], "y_m": [10.0 * x for x in track["x_m"]]}
    (drawing,) = trajectories.trajectories(document)
    seen = picture(drawing)
    assert seen.x(100) - seen.x(0) == near(seen.y(0) - seen.y(100), 5)
    assert max(y for line in seen.of("line", "polyline") for _, y in points(line)) < 400


def test_moments_that_are_near_each_other_have_one_label() -> None:
    dots = [(1, (0.0, 0.0)), (2, (3.0, 0.0)), (3, (10.0, 0.0)), (4, (50.0, 0.0))]
    assert [mark.text for mark in trajectories.merged(dots)] == ["1-3", "4"]


def test_an_event_that_did_not_end_shows_the_whole_rest_of_the_drive() -> None:
    one = {**ENCOUNTER, "stop": None, "moments": [{"what": "event", "seconds": 1.0}]}
    (drawing,) = trajectories.trajectories(changed(encounters=[one]))
    assert [len(points(line)) for line in picture(drawing).of("line", "polyline")] == [5, 5]
    assert "nearest 30.0 m" in picture(drawing).texts("mark")
    (drawing,) = trajectories.trajectories(changed(encounters=[{**one, "stop": ENCOUNTER["stop"]}]))
    assert [len(points(line)) for line in picture(drawing).of("line", "polyline")] == [4, 4]


def test_a_label_stands_where_nothing_else_does() -> None:
    first, second, shares = (0.0, 0.0), (200.0, 100.0), (0.2, 0.5, 0.8)
    everywhere = [((0.0, 10.0 * n), 1000.0) for n in range(20)]
    for occupied, place in (([], (40, 20)), ([((40.0, 20.0), 76.0)], (100, 50)), (everywhere, (160, 80))):
        assert trajectories.free_place(first, second, shares, occupied) == near(place, 0.1)


def test_the_distance_of_a_story_without_a_rule_has_no_thresholds() -> None:
    (drawing,) = distances.distances({**changed(encounters=[]), "parameters": {"start_distance_m": 100}})
    assert picture(drawing).of("threshold") == []


def test_without_an_encounter_all_routes_are_drawn() -> None:
    (drawing,) = trajectories.trajectories(changed(encounters=[]))
    assert drawing.caption.endswith("no encounter")
    assert len(picture(drawing).of("line", "polyline")) == 2


def test_one_vehicle_alone_has_a_trajectory_and_no_distance() -> None:
    document = changed(encounters=[])
    del document["drawings"]["trajectories"]["agents"][OTHER]
    assert len(list(trajectories.trajectories(document))) == 1
    with pytest.raises(NoDrawingError, match="two vehicles"):
        list(distances.distances(document))


# ages -----------------------------------------------------------------------------------------------------------------


def test_ages_are_shown_as_shares_with_the_quantiles_and_the_bound() -> None:
    drawing, _ = ages.ages(DOCUMENT)
    seen = picture(drawing)
    bars = {round(seen.x(corner(bar)[0])): seen.y(corner(bar)[2]) for bar in seen.of("bar0")}
    assert {age: share for age, share in bars.items() if share > 0.1} == near({5: 60, 6: 39, 30: 1}, 0.3)
    assert seen.texts("mark") == ["p50 6 ms", "p99 7 ms", "bound of p99 50 ms"]
    assert [seen.x(float(one.get("x1", ""))) for one in seen.of("threshold")] == near([6, 7, 50], 0.1)
    assert "100 poses of all vehicles; 0 are older than shown" in drawing.key[0].text


def test_each_vehicle_has_a_row_and_a_silence_stays_empty() -> None:
    _, drawing = ages.ages(DOCUMENT)
    seen = picture(drawing)
    areas = seen.of("area")
    floors = [float(one.get("y1", "")) for one in seen.of("base")]
    assert [len(points(area)) - 2 for area in areas] == [3, 1, 4]
    heights = [floors[0] - y for _, y in points(areas[0])[1:-1]]
    assert [heights[2] / height for height in heights] == near([4.0, 2.0, 1.0], 0.1)
    assert floors[1] - points(areas[2])[-2][1] == near(heights[1], TENTH * 2)  # on one scale
    assert [seen.x(x) for x, _ in points(areas[0])[1:-1]] == near([0, 1, 2], 0.02)
    assert [text for text in seen.texts("label") if text != "greatest p99"] == [ONE, OTHER]


def test_of_many_vehicles_those_with_the_oldest_poses_are_shown() -> None:
    one = {"seconds": [0, 1], "p50_ms": [1, 1]}
    many = {f"v-{n:02}": {**one, "p99_ms": [n, n]} for n in range(50)}
    _, drawing = ages.ages(changed(pose_ages={**DOCUMENT["drawings"]["pose_ages"], "vehicles": many}))
    assert picture(drawing).texts("label") == [f"v-{n:02}" for n in range(30, 50)]
    assert "30 vehicles with younger poses are left out" in drawing.key[-1].text


def test_ages_without_seconds_are_a_distribution_alone() -> None:
    drawn = gallery(changed(pose_ages={"milliseconds": [5], "poses": [3], "vehicles": {}}))["ages"]
    assert [drawing.caption for drawing in drawn.drawings] == ["Pose age: distribution"]
    assert "older event detectors" in drawn.missing


@pytest.mark.parametrize(("share", "age"), [(0.5, 6), (0.6, 6), (0.61, 7), (0.99, 7), (0.991, 31), (1.0, 31)])
def test_a_quantile_is_the_upper_edge_of_its_bucket(share: float, age: float) -> None:
    assert ages.quantile([(5, 60), (6, 39), (30, 1)], share) == age


# ways -----------------------------------------------------------------------------------------------------------------


def test_steps_stand_from_their_begin_to_their_end_and_the_critical_ones_are_joined() -> None:
    deployment, removal = ways.ways(DOCUMENT)
    seen = picture(deployment)
    spans = {
        str(bar.findtext("title")).partition(":")[0]: [seen.x(place) for place in corner(bar)[:2]]
        for bar in seen.root.iter("rect")
    }
    assert spans == {
        "detection": near([0.0, 0.5], 0.01),
        "gate": near([0.5, 2.0], 0.01),
        "plan observed": near([0.5, 1.0], 0.01),
    }
    assert [len(seen.of(kind, "rect")) for kind in ("critical", "beside")] == [2, 1]
    assert [seen.x(float(joint.get("x1", ""))) for joint in seen.of("joint")] == near([0.5], 0.01)
    assert [entry.text for entry in deployment.key] == ["critical path, 2.000 s", "beside it"]
    assert "0.500 s" in seen.texts("tick")
    assert removal.caption == "Encounter 1: from its end to the last pod gone"


def test_a_step_that_was_not_seen_has_no_bar_and_no_joint() -> None:
    steps = [ENCOUNTER["deployment"][0], {"step": "storing", "begin": 2.5, "end": 3.0, "critical": True}]  # type: ignore[index]
    (drawing,) = ways.ways(changed(encounters=[{**ENCOUNTER, "deployment": steps, "removal": []}]))
    assert picture(drawing).of("joint") == []


# cores ----------------------------------------------------------------------------------------------------------------


def test_cores_stand_upon_each_other_in_steps() -> None:
    (drawing,) = cores.cores(DOCUMENT)
    seen = picture(drawing)
    lower, upper = ([seen.value(point) for point in points(layer)] for layer in seen.of("layer"))
    steps = [(-1, 0.5), (0, 0.5), (0, 1.0), (2, 1.0), (2, 0.5), (4, 0.5)]
    sums = [(-1, 0.75), (0, 0.75), (0, 1.25), (2, 1.25), (2, 1.5), (4, 1.5)]
    for layer, expected in ((lower, steps), (upper, sums)):
        for place, value in zip(layer, expected, strict=False):
            assert place == near(value, 0.02)
    assert upper[6:] == lower[5::-1]
    assert [seen.x(float(one.get("x1", ""))) for one in seen.of("event")] == near([1.0, 3.5], 0.02)
    assert "At most 1.50 cores together. On average: kubelet 0.70, broker 0.55." in drawing.svg


# recordings -----------------------------------------------------------------------------------------------------------


def test_recordings_show_their_window_their_messages_and_their_gaps() -> None:
    (drawing,) = coverage.coverage(DOCUMENT)
    seen = picture(drawing)

    def spans(kind: str) -> list[list[float]]:
        return [[seen.x(place) for place in corner(one)[:2]] for one in seen.of(kind, "rect")]

    assert spans("recorded") == [near([1.5, 4.0], 0.02), near([2.0, 3.5], 0.02)]
    assert spans("gap") == [near([2.5, 2.8], 0.02), near([2.0, 3.5], 0.02)]
    assert spans("window") == [near([2.0, 3.5], 0.02)]
    assert seen.texts("heading") == ["recording 1: window 1.5 s, lost 2"]
    assert "gaps: 2" in [entry.text for entry in drawing.key]
    rows_of_bars = [corner(one)[2] for one in seen.of("recorded", "rect")]
    assert rows_of_bars[1] - rows_of_bars[0] == near(coverage.ROW_HEIGHT, TENTH)
    assert corner(seen.of("gap", "rect")[0])[2] == near(rows_of_bars[1] - 1, TENTH)


# all of them ----------------------------------------------------------------------------------------------------------


def test_every_drawing_is_well_formed_and_says_what_it_shows() -> None:
    drawn = gallery(DOCUMENT)
    assert [one.missing for one in drawn.values()] == [""] * len(DRAWINGS)
    names: list[str] = []
    for drawing in (one for kind in drawn.values() for one in kind.drawings):
        root = picture(drawing).root
        ids = str(root.get("aria-labelledby")).split()
        assert [root.find("title").get("id"), root.find("desc").get("id")] == ids  # type: ignore[union-attr]
        assert root.findtext("title") == drawing.caption
        assert root.findtext("desc")
        assert str(root.get("viewBox")).startswith("0 0 400 ")
        names += ids
    assert len(names) == len(set(names)) == 2 * 8


def test_texts_are_escaped_and_characters_that_xml_lacks_replaced() -> None:
    drawn = gallery(renamed(DOCUMENT))
    assert [one.missing for one in drawn.values()] == [""] * len(DRAWINGS)
    for drawing in (one for kind in drawn.values() for one in kind.drawings):
        assert "<b>" not in drawing.svg
        picture(drawing)


def renamed(value: Any) -> Any:
    """The document with vehicles and components that are named to do harm."""
    if isinstance(value, dict):
        return {renamed(key) if key in (ONE, "kubelet") else key: renamed(one) for key, one in value.items()}
    if isinstance(value, list):
        return [renamed(one) for one in value]
    return '<b>&"\x00' if value in (ONE, "kubelet", "gate", "event") else value


def test_a_report_of_an_older_version_says_why_nothing_is_drawn() -> None:
    document = changed()
    del document["drawings"]
    assert {one.missing for one in gallery(document).values()} == {OLDER}


@pytest.mark.parametrize("nothing", [None, {}, []])
def test_nothing_to_draw_is_said_of_each_kind(nothing: Any) -> None:
    drawn = gallery({**DOCUMENT, "drawings": dict.fromkeys(DOCUMENT["drawings"], nothing)})
    for kind, one in drawn.items():
        assert one.drawings == ()
        assert "report.json" in one.missing, kind


ODD: Mapping[str, Callable[[Any], Any]] = {
    "no number": lambda value: nan if isinstance(value, float | int) else value,
    "not known": lambda value: None if isinstance(value, float | int) else value,
    "all zero": lambda value: 0 if isinstance(value, float | int) else value,
    "enormous": lambda value: 1e300 if isinstance(value, float | int) else value,
    "words": lambda value: "x" if isinstance(value, float | int) else value,
    "empty lists": lambda value: [] if isinstance(value, list) else value,
    "short lists": lambda value: value[:1] if isinstance(value, list) else value,
}


def odd(value: Any, change: Callable[[Any], Any]) -> Any:
    if isinstance(value, dict):
        return {key: odd(one, change) for key, one in value.items()}
    value = change(value)
    return [odd(one, change) for one in value] if isinstance(value, list) else value


@pytest.mark.parametrize("how", ODD)
def test_odd_data_lose_a_drawing_at_most(how: str) -> None:
    drawn = gallery({**DOCUMENT, "drawings": odd(DOCUMENT["drawings"], ODD[how])})
    for one in drawn.values():
        assert one.drawings or one.missing
        for drawing in one.drawings:
            assert picture(drawing)
            assert "nan" not in drawing.svg.partition("</desc>")[2]


def test_a_number_that_is_none_leaves_its_row_out() -> None:
    assert rows({"a": [1, nan, 3, True], "b": [1.5, 2, None, 4]}, "a", "b") == [(1.0, 1.5)]
    assert finite("5") is None


def test_between_two_places_a_vehicle_is_on_the_straight_line() -> None:
    track = [(0.0, 0.0, 10.0), (2.0, 20.0, 10.0)]
    assert at(track, 0.5) == (5.0, 10.0)
    assert at(track, 2.5) is None


@pytest.mark.parametrize(("low", "high", "ticks"), [(0, 10, (0, 2, 4, 6, 8, 10)), (-3, 88, (0, 20, 40, 60, 80))])
def test_ticks_are_round(low: float, high: float, ticks: tuple[float, ...]) -> None:
    assert Scale(low, high, 0, 1).ticks() == near(ticks, 1e-9)
    assert step_of(0.03) == near(0.05, 1e-9)


def test_a_name_that_does_not_fit_is_cut() -> None:
    assert shortened("vehicle-00", 100) == "vehicle-00"
    assert shortened("vehicle-00", 30) == "vehi…"
