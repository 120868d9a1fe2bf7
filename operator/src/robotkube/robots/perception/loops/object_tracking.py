"""The service object-tracking: the objects of each cloud in, the same with identities out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from robotkube.robots.perception.core.messages import POSES_TYPE, TEXT_TYPE, read_poses, write_text
from robotkube.robots.perception.core.tracking import Tracker, tracks_text
from robotkube.robots.perception.core.tracking_settings import TrackingSettings
from robotkube.robots.perception.loops.service import Log, MessageProcessor

if TYPE_CHECKING:
    from robotkube.robots.ros.ports import RobotNetwork

POSES_KEPT_MAX = 100


class ObjectTracking:
    """Tracks objects with the settings it was given last; identities begin anew when these change."""

    def __init__(self, network: RobotNetwork, log: Log) -> None:
        self.processor = MessageProcessor("tracking", network, log)
        self._settings: TrackingSettings | None = None
        self._tracker: Tracker | None = None

    def configure(self, settings: TrackingSettings) -> None:
        """Apply settings; topics are opened anew only when they changed."""
        before = self._settings
        self._settings = settings
        if before is None or before.tracker != settings.tracker:
            self._tracker = Tracker(settings.tracker)
        if before is not None and (before.objects, before.tracks) == (settings.objects, settings.tracks):
            return
        sinks = [(settings.tracks, TEXT_TYPE)]
        self.processor.open((settings.objects, POSES_TYPE), sinks, self._track, POSES_KEPT_MAX)

    def _track(self, data: bytes) -> Mapping[str, bytes]:
        assert self._settings is not None
        assert self._tracker is not None
        poses = read_poses(data)
        text = tracks_text(poses, self._tracker.observe(poses))
        return {self._settings.tracks: write_text(text)}
