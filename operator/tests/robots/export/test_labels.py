"""Labels of the demo's clouds against what the generator put there, and datasets as others read them."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robotkube.cli.recordings.export import write_dataset
from robotkube.errors import InputError
from robotkube.robots.bags.adapters.command_line_bags import Bags
from robotkube.robots.bags.adapters.writing import BagWriter
from robotkube.robots.bags.core.playback import BagTopic
from robotkube.robots.export.adapters.kitti_dataset import preview
from robotkube.robots.export.core.labels import SIZE_DEFAULT, Label, LabellingSettings
from robotkube.robots.export.core.png import GREEN
from robotkube.robots.export.loops.labelling import POSES_DEFAULT, LabellingCounts, label_clouds
from robotkube.robots.perception.core.point_clouds import read_cloud
from scenarios import definition
from scenarios.generator import bags
from scenarios.generator.scene import VEHICLE, VEHICLE_SIZE_M
from tests.stages.paths import SCENARIOS
from tests.stages.ros import lidar_clouds

FOLDER = SCENARIOS / "pose-point-cloud-db-recording"
SETTINGS = ["vehicles=2", "encounters=1", "points=6000", "point_cloud_hz=5", "pose_hz=20"]
MARGIN_M = 0.05
"""Five standard deviations of the lidar's noise."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    scenario = definition.load(FOLDER, SETTINGS)
    return bags.make_bags(scenario, tmp_path_factory.mktemp("cache"), lambda text: None)


def test_the_box_holds_the_other_vehicles_points(made: Mapping[str, Path]) -> None:
    counts = LabellingCounts()
    shown = held = 0
    with Bags(list(made.values()), pytest.fail) as opened:
        for cloud in label_clouds(opened, opened.layouts, LabellingSettings(distance_m=300.0), counts):
            points = np.array([cloud.cloud.x, cloud.cloud.y, cloud.cloud.z], np.float64).T
            vehicle = points[np.array(cloud.cloud.intensity, np.float32) == np.float32(VEHICLE)]
            if not len(vehicle):
                continue
            shown += 1
            (label,) = cloud.labels
            cosine = np.cos(label.heading)
            sine = np.sin(label.heading)
            offset = vehicle - np.array(label.position)
            along = offset @ np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
            held += bool((np.abs(along) <= np.array(VEHICLE_SIZE_M) / 2 + MARGIN_M).all())
            assert label.points >= len(vehicle) * 0.95
            assert label.age_seconds <= 0.05
            assert 0 < label.position_uncertainty_m < 0.02 + 0.002 * label.distance_m
    assert counts.unlocated <= 2  # nothing is extrapolated beyond the last pose
    assert not counts.unreadable
    assert shown > 30
    assert held >= 0.95 * shown


def test_a_dataset_in_kittis_layout(made: Mapping[str, Path], tmp_path: Path) -> None:
    reported: list[str] = []
    folder = tmp_path / "dataset"
    with pytest.raises(InputError, match=r"poses of at least two: the bag has 1 topics .* poses of vehicle-00"):
        write_dataset(
            made["vehicle-00"], tmp_path / "none", "meeting", LabellingSettings(), POSES_DEFAULT, reported.append
        )
    joined = tmp_path / "joined"
    joined.mkdir()
    for path in made.values():
        (joined / f"{path.name}.mcap").symlink_to(path / f"{path.name}.mcap")
    counts = write_dataset(joined, folder, "meeting", LabellingSettings(), POSES_DEFAULT, reported.append)
    lines = [json.loads(line) for line in (folder / "labels.jsonl").read_text().splitlines()]
    assert len(lines) == counts.clouds
    assert sum(len(line["labels"]) for line in lines) == counts.boxes > 0
    best = max(lines, key=lambda line: sum(label["points"] for label in line["labels"]))
    (label,) = best["labels"]
    points = np.fromfile(folder / "training" / "velodyne" / f"{best['frame']}.bin", "<f4").reshape(-1, 4)
    words = (folder / "training" / "label_2" / f"{best['frame']}.txt").read_text().split()
    calibration = (folder / "training" / "calib" / f"{best['frame']}.txt").read_text()
    row = next(line for line in calibration.splitlines() if line.startswith("Tr_velo_to_cam"))
    to_camera = np.array(row.split()[1:], float).reshape(3, 4)
    assert words[0] == "Car"
    height, width, length, x, y, z, turned = map(float, words[8:15])
    camera = points[:, :3] @ to_camera[:, :3].T + to_camera[:, 3]  # as KITTI's readers do
    offset = camera - np.array([x, y, z])
    cosine = np.cos(turned)
    sine = np.sin(turned)
    along, across = cosine * offset[:, 0] - sine * offset[:, 2], sine * offset[:, 0] + cosine * offset[:, 2]
    inside = (
        (np.abs(along) <= length / 2 + MARGIN_M)
        & (np.abs(across) <= width / 2 + MARGIN_M)
        & (offset[:, 1] <= MARGIN_M)
        & (offset[:, 1] >= -height - MARGIN_M)
    )
    assert inside.sum() == pytest.approx(label["points"], abs=2)
    assert label["points"] > 20
    assert "labels.jsonl" in (folder / "README.md").read_text()
    assert_picture((folder / "preview.png").read_bytes())
    assert any(text.startswith("dataset: ") for text in reported)


def test_why_no_cloud_can_be_labelled_is_said(made: Mapping[str, Path], tmp_path: Path) -> None:
    with Bags(list(made.values()), pytest.fail) as opened:
        types = {name: kind for name, kind in opened.types.items() if not name.endswith("/transform")}
        played = list(opened.played(set(types), 10**18))
        clouds = [name for name, kind in types.items() if kind == "sensor_msgs/msg/PointCloud2"]
    topics = [BagTopic(name, kind, "reliable", "volatile", 10) for name, kind in types.items()]
    with BagWriter(tmp_path / "bag", topics) as bag:
        for name, stamp, data in [*played, (clouds[0], 10**18, b"short")]:
            bag.add(name, stamp, data)
        bag.finish()
    reported: list[str] = []
    number = sum(name in clouds for name, *_ in played)
    with pytest.raises(InputError, match=f"{number} of unknown place, 1 messages unreadable"):
        write_dataset(
            tmp_path / "bag", tmp_path / "out", "meeting", LabellingSettings(), POSES_DEFAULT, reported.append
        )
    assert any("no transform leads from frame 'vehicle_00/lidar_center' to a vehicle's" in text for text in reported), (
        reported
    )


def test_a_vehicle_far_away_leaves_the_preview_to_those_that_are_near() -> None:
    near = Label("near", (20.0, 0.0, 0.0), 0.0, SIZE_DEFAULT, 20.0, 0.0, 0.0, 0.0, points=9)
    picture = preview(
        read_cloud(lidar_clouds.cloud(stamp=1, points=10)), [near, replace(near, position=(5e4, 0.0, 0.0))]
    )
    green = [(x, y) for x in range(picture.width) for y in range(picture.height) if picture.colour(x, y) == GREEN]
    assert len(green) > 20


def assert_picture(data: bytes) -> None:
    """A whole PNG of the right size that shows a box."""
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    width, height = struct.unpack_from(">II", data, 16)
    assert (width, height) == (800, 800)
    place = data.index(b"IDAT")
    (size,) = struct.unpack_from(">I", data, place - 4)
    rows = np.frombuffer(zlib.decompress(data[place + 4 : place + 4 + size]), np.uint8).reshape(height, 1 + 3 * width)
    pixels = rows[:, 1:].reshape(height, width, 3)
    assert (pixels == (70, 220, 120)).all(axis=2).sum() > 40
    assert (pixels == (225, 225, 225)).all(axis=2).sum() > 500
