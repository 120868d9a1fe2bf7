"""The dataset layout of KITTI's object benchmark (its development kit, "Data Format Description"), as texts. Pure.

KITTI's camera looks along x of the sensor: x right, y down, z ahead. There is no picture, so the box in it is 0 0 0 0.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.robots.export.core.labels import Label, LabellingSettings

KIND = "Car"
CALIBRATION = (
    "".join(f"P{number}: 1 0 0 0 0 1 0 0 0 0 1 0\n" for number in range(4))
    + "R0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\nTr_imu_to_velo: 1 0 0 0 0 1 0 0 0 0 1 0\n"
)


def label_line(label: Label) -> str:
    """One line of label_2: location is the middle of the box's bottom, in the frame of the camera."""
    x, y, z = label.position
    length, width, height = label.size
    location = -y, height / 2 - z, x
    turned = _wrapped(-label.heading - math.pi / 2)
    alpha = _wrapped(turned - math.atan2(location[0], location[2]))
    numbers = (height, width, length, *location, turned)
    occluded = 0 if label.points else 3
    return f"{KIND} 0.00 {occluded} {alpha:.4f} 0.00 0.00 0.00 0.00 {' '.join(f'{n:.4f}' for n in numbers)}\n"


def json_line(frame: str, topic: str, frame_id: str, stamp: int, labels: Sequence[Label]) -> str:
    """One line of labels.jsonl: everything that label_2 has no place for."""
    document: Mapping[str, Any] = {
        "frame": frame,
        "topic": topic,
        "frame_id": frame_id,
        "stamp": stamp,
        "labels": [label.document() for label in labels],
    }
    return json.dumps(document) + "\n"


def readme_text(name: str, settings: LabellingSettings, counts: Mapping[str, int]) -> str:
    """The text of the dataset's README.md."""
    length, width, height = settings.size
    return f"""# Point clouds of {name}, labelled by the other vehicles' poses

Layout of KITTI's object benchmark, so that its readers read it:

    training/velodyne/NNNNNN.bin   the cloud: float32 x, y, z, intensity per point, little endian, frame of the sensor
    training/label_2/NNNNNN.txt    one line per box: {KIND}, 0.00, 0 (3: no point lies in it), alpha, 0 0 0 0,
                                   height, width, length, location x y z, rotation_y; frame of the camera
    training/calib/NNNNNN.txt      the camera is the sensor with other axes: x right, y down, z ahead; no pictures
    labels.jsonl                   one line per cloud, frame of the sensor (x ahead, y left, z up), and what KITTI lacks
    preview.png                    a cloud from above, 10 m between the lines, with its boxes

A label is the other vehicle's own pose, interpolated at the cloud's stamp (position linear, orientation on the great
circle) and transformed into the sensor's frame by the sensor's own pose and the recorded transforms. In labels.jsonl:

- `position` (of the box's centre, m), `heading` (about z, rad), `size` (length, width, height), `distance_m`
- `age_seconds`: from the cloud to the nearest pose message of that vehicle
- `position_uncertainty_m`, `heading_uncertainty_rad`: the poses' own deviation (of their covariance, or \
{settings.pose_sigma_m:g} m, {settings.heading_sigma_rad:g} rad as given
  where they have none) and the most that interpolation can be wrong at 10 m/s2 and 3 rad/s2
- `points`: points of the cloud within the box, 5 cm of noise allowed; 0: hidden, or too far for the sensor

Boxes are {length:g} x {width:g} x {height:g} m, the pose on the ground at the centre. Vehicles beyond \
{settings.distance_m:g} m are not labelled.

{chr(10).join(f"- {key}: {value}" for key, value in counts.items())}
"""


def _wrapped(angle: float) -> float:
    return (angle + math.pi) % (2 * math.pi) - math.pi
