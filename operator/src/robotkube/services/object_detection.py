"""The service object-detection: a lidar's clouds in; the objects' poses and their uncertainty out, for every cloud."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from robotkube.domain.finding_objects import find_objects, uncertainty
from robotkube.domain.perception_messages import (
    CLOUD_TYPE,
    NUMBER_TYPE,
    POSES_TYPE,
    read_cloud,
    write_number,
    write_poses,
)
from robotkube.domain.perception_settings import DetectionSettings
from robotkube.services.perceiving import Log, Perceiving

if TYPE_CHECKING:
    from robotkube.ports.robots import RobotNetwork

CLOUDS_MAX = 2  # an older cloud is worth less than a late one


class ObjectDetection:
    """Finds objects with the settings it was given last."""

    def __init__(self, network: RobotNetwork, log: Log) -> None:
        self.perceiving = Perceiving("detection", network, log)
        self._settings: DetectionSettings | None = None

    def configure(self, settings: DetectionSettings) -> None:
        """Apply settings; topics are opened anew only when they changed."""
        before, self._settings = self._settings, settings
        topics = settings.cloud, settings.objects, settings.uncertainty
        if before is not None and topics == (before.cloud, before.objects, before.uncertainty):
            return
        sinks = [(settings.objects, POSES_TYPE), (settings.uncertainty, NUMBER_TYPE)]
        self.perceiving.open((settings.cloud, CLOUD_TYPE), sinks, self._find, CLOUDS_MAX)

    def _find(self, data: bytes) -> Mapping[str, bytes]:
        assert self._settings is not None
        cloud = read_cloud(data)
        found = find_objects(cloud, self._settings.finding)
        return {
            self._settings.objects: write_poses(cloud.header, [one.pose for one in found]),
            self._settings.uncertainty: write_number(uncertainty(found)),
        }
