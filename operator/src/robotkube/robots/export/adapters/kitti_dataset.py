"""Writes labelled clouds as a dataset in KITTI's layout, with labels.jsonl, README.md and a preview."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from io import TextIOWrapper
from pathlib import Path

from robotkube.errors import InputError
from robotkube.robots.export.core.kitti import CALIBRATION, json_line, label_line, readme_text
from robotkube.robots.export.core.labels import Label, LabellingSettings, corners, interleaved
from robotkube.robots.export.core.png import GREEN, GREY, ORANGE, WHITE, Picture
from robotkube.robots.perception.core.point_clouds import Cloud

FRAMES_MAX = 1_000_000
PREVIEW_PIXELS = 800
PREVIEW_MARGIN_M = 10.0
PREVIEW_REACH_MAX_M = 200.0
GRID_M = 10
PARTS = ("velodyne", "label_2", "calib")


class KittiDataset:
    """A dataset in the new `folder`; OSError and InputError when it cannot be written. Keeps one cloud for the preview:
    the one with most points in its boxes."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        for part in PARTS:
            (folder / "training" / part).mkdir(parents=True)
        self._lines: TextIOWrapper = (folder / "labels.jsonl").open("w", encoding="utf-8")
        self.frames = 0
        self._best: tuple[int, Cloud, Sequence[Label]] | None = None

    def add(self, topic: str, cloud: Cloud, labels: Sequence[Label]) -> None:
        """Add a cloud with its labels."""
        if self.frames >= FRAMES_MAX:
            raise InputError(f"more than {FRAMES_MAX} clouds; export a part with --from and --to")
        name = f"{self.frames:06d}"
        points = interleaved(cloud)
        if sys.byteorder == "big":
            points.byteswap()
        self._write("velodyne", f"{name}.bin", points.tobytes())
        self._write("label_2", f"{name}.txt", "".join(map(label_line, labels)).encode())
        self._write("calib", f"{name}.txt", CALIBRATION.encode())
        self._lines.write(json_line(name, topic, cloud.header.frame, cloud.header.stamp, labels))
        self.frames += 1
        seen = sum(label.points for label in labels)
        if self._best is None or seen > self._best[0]:
            self._best = (seen, cloud, labels)

    def finish(self, name: str, settings: LabellingSettings, counts: Mapping[str, int]) -> None:
        """Write README and preview; nothing more is added."""
        self._lines.close()
        (self._folder / "README.md").write_text(readme_text(name, settings, counts), encoding="utf-8")
        if self._best is not None:
            (self._folder / "preview.png").write_bytes(preview(self._best[1], self._best[2]).png())

    def close(self) -> None:
        """Close the open file."""
        self._lines.close()

    def _write(self, part: str, name: str, data: bytes) -> None:
        (self._folder / "training" / part / name).write_bytes(data)


def preview(cloud: Cloud, labels: Sequence[Label]) -> Picture:
    """The cloud from above: x of the sensor up, y to the left; boxes with points green, others orange. Boxes beyond
    PREVIEW_REACH_MAX_M are not in it: nobody saw the others beside them."""
    farthest = max((abs(p) for label in labels for p in label.position[:2]), default=40.0)
    reach = min(farthest + PREVIEW_MARGIN_M, PREVIEW_REACH_MAX_M)
    scale = PREVIEW_PIXELS / (2 * reach)
    middle = PREVIEW_PIXELS / 2
    picture = Picture(PREVIEW_PIXELS, PREVIEW_PIXELS)
    for line in range(-int(reach) // GRID_M * GRID_M, int(reach) + 1, GRID_M):
        place = middle + line * scale
        picture.line(place, 0, place, PREVIEW_PIXELS, GREY)
        picture.line(0, place, PREVIEW_PIXELS, place, GREY)
    for x, y in zip(cloud.x, cloud.y, strict=True):
        if abs(x) < reach and abs(y) < reach:
            picture.point(middle - y * scale, middle - x * scale, WHITE)
    for label in labels:
        places = [(middle - y * scale, middle - x * scale) for x, y in corners(label)]
        picture.outline(places, GREEN if label.points else ORANGE)
    return picture
