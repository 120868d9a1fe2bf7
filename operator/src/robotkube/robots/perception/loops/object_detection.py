"""The service object-detection: a lidar's clouds in; the objects' poses and their uncertainty out, for every cloud."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from robotkube.robots.perception.core.detection import find_objects, uncertainty
from robotkube.robots.perception.core.detection_settings import DetectionSettings
from robotkube.robots.perception.core.messages import (
    CLOUD_TYPE,
    NUMBER_TYPE,
    POSES_TYPE,
    write_number,
    write_poses,
)
from robotkube.robots.perception.core.point_clouds import read_cloud
from robotkube.robots.perception.loops.service import Log, MessageProcessor

if TYPE_CHECKING:
    from robotkube.robots.ros.ports import RobotNetwork

CLOUDS_MAX = 2  # an older cloud is worth less than a late one


class ObjectDetection:
    """Detects objects in clouds with the settings it was given last."""

    def __init__(self, network: RobotNetwork, log: Log) -> None:
        self.processor = MessageProcessor("detection", network, log)
        self._settings: DetectionSettings | None = None

    def configure(self, settings: DetectionSettings) -> None:
        """Apply settings; topics are opened anew only when they changed."""
        before = self._settings
        self._settings = settings
        topics = settings.cloud, settings.objects, settings.uncertainty
        if before is not None and topics == (before.cloud, before.objects, before.uncertainty):
            return
        sinks = [(settings.objects, POSES_TYPE), (settings.uncertainty, NUMBER_TYPE)]
        self.processor.open((settings.cloud, CLOUD_TYPE), sinks, self._detect, CLOUDS_MAX)

    def _detect(self, data: bytes) -> Mapping[str, bytes]:
        assert self._settings is not None
        cloud = read_cloud(data)
        objects = find_objects(cloud, self._settings.criteria)
        return {
            self._settings.objects: write_poses(cloud.header, [detected.pose for detected in objects]),
            self._settings.uncertainty: write_number(uncertainty(objects)),
        }
