"""Layouts of recordings for Foxglove and Lichtblick: each panel is there once, and none is empty."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from robotkube.robots.export.core.foxglove_layout import PLOTTED_MAX, TOPICS_MAX, recording_layout

POSES = [f"/vehicles/vehicle_{number:02d}/pose" for number in range(2)]
CLOUD = "/vehicles/vehicle_00/lidar_center/pointcloud"


def panels(place: Any) -> Iterator[str]:
    """The panels at a place of the layout, from the left and from above."""
    if isinstance(place, str):
        yield place
    else:
        yield from (*panels(place["first"]), *panels(place["second"]))


def test_every_panel_has_its_settings_and_a_place() -> None:
    layout = recording_layout([*POSES, CLOUD])
    placed = list(panels(layout["layout"]))
    assert sorted(placed) == sorted(layout["configById"])
    assert [name.partition("!")[0] for name in placed] == ["3D", "Plot", "RawMessages", "SourceInfo"]


def test_topics_are_shown_and_positions_are_plotted() -> None:
    settings = recording_layout([CLOUD, *POSES, CLOUD])["configById"]
    assert settings["3D!space"]["topics"] == {name: {"visible": True} for name in sorted([CLOUD, *POSES])}
    paths = [path["value"] for path in settings["Plot!positions"]["paths"]]
    assert paths == [f"{pose}.pose.position.{axis}" for pose in POSES for axis in ("x", "y")]
    assert settings["RawMessages!first"]["topicPath"] == POSES[0]


def test_many_topics_are_bounded_and_none_is_no_mistake() -> None:
    settings = recording_layout(f"/{number:04d}/pose" for number in range(TOPICS_MAX + 50))["configById"]
    assert len(settings["3D!space"]["topics"]) == TOPICS_MAX
    assert len(settings["Plot!positions"]["paths"]) == 2 * PLOTTED_MAX
    assert recording_layout([])["configById"]["RawMessages!first"]["topicPath"] == ""
