"""Identities of detected objects from cloud to cloud: each new place goes to the track that expects it nearest.

Two motions. `still`: a track is expected where it was. `steady`: it is expected where its velocity has taken it, so
objects may be fast and out of sight for longer. Lengths in m, times in ns, velocities in m/s.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from robotkube.robots.perception.core.messages import Poses
from robotkube.robots.ros.core.cdr import NANOSECONDS

STILL = "still"
STEADY = "steady"
MOTIONS = (STILL, STEADY)
VELOCITY_SHARE = 0.5  # of a new measurement in the velocity
TRACKS_MAX = 200


@dataclass(frozen=True)
class TrackerSettings:
    """The settings of a tracker. `gate_m`: the greatest distance of an object from where it is expected; `gap_seconds`:
    the longest time that it may be out of sight."""

    motion: str
    gate_m: float
    gap_seconds: float


@dataclass(frozen=True)
class Track:
    """One object: its identity, latest place, velocity, and when it was seen first and last."""

    id: int
    x: float
    y: float
    z: float
    first: int
    last: int
    velocity: tuple[float, float] = (0.0, 0.0)

    @property
    def age_seconds(self) -> float:
        """The time for which it has been tracked."""
        return (self.last - self.first) / NANOSECONDS


class Tracker:
    """Tracks the objects of one sensor. Identities count from 1 and are never used again."""

    def __init__(self, settings: TrackerSettings) -> None:
        self.settings = settings
        self._tracks: dict[int, Track] = {}
        self._next = 1
        self._stamp = -1

    def observe(self, poses: Poses) -> tuple[Track, ...]:
        """The tracks that are seen in `poses`, by identity. Poses that are not newer than the last change nothing."""
        stamp = poses.header.stamp
        if stamp <= self._stamp:
            return self._seen()
        self._stamp = stamp
        self._forget(stamp)
        places = [(pose.x, pose.y, pose.z) for pose in poses.poses[:TRACKS_MAX]]
        matches = self._matches(places, stamp)
        for index, place in enumerate(places):
            known = self._tracks[matches[index]] if index in matches else None
            track = self._moved(known, place, stamp) if known is not None else self._new(place, stamp)
            self._tracks[track.id] = track
        return self._seen()

    def _seen(self) -> tuple[Track, ...]:
        return tuple(track for _, track in sorted(self._tracks.items()) if track.last == self._stamp)

    def _forget(self, stamp: int) -> None:
        oldest = stamp - int(self.settings.gap_seconds * NANOSECONDS)
        self._tracks = {number: track for number, track in self._tracks.items() if track.last >= oldest}

    def _matches(self, places: Sequence[tuple[float, float, float]], stamp: int) -> dict[int, int]:
        """Index of a place -> identity, the nearest pairs first."""
        expected = {track.id: self._expected(track, stamp) for track in self._tracks.values()}
        pairs = sorted(
            (distance, index, number)
            for index, place in enumerate(places)
            for number, spot in expected.items()
            if (distance := math.dist(place[:2], spot)) <= self.settings.gate_m
        )
        matches: dict[int, int] = {}
        for _, index, number in pairs:
            if index not in matches and number not in matches.values():
                matches[index] = number
        return matches

    def _expected(self, track: Track, stamp: int) -> tuple[float, float]:
        if self.settings.motion == STILL:
            return track.x, track.y
        seconds = (stamp - track.last) / NANOSECONDS
        return track.x + track.velocity[0] * seconds, track.y + track.velocity[1] * seconds

    def _moved(self, track: Track, place: tuple[float, float, float], stamp: int) -> Track:
        seconds = (stamp - track.last) / NANOSECONDS
        measured = (place[0] - track.x) / seconds, (place[1] - track.y) / seconds
        share = 1.0 if track.first == track.last else VELOCITY_SHARE
        velocity = tuple(old + share * (new - old) for old, new in zip(track.velocity, measured, strict=True))
        x, y, z = place
        return replace(track, x=x, y=y, z=z, last=stamp, velocity=(velocity[0], velocity[1]))

    def _new(self, place: tuple[float, float, float], stamp: int) -> Track:
        track = Track(self._next, *place, first=stamp, last=stamp)
        self._next += 1
        return track


def tracks_text(poses: Poses, tracks: Sequence[Track]) -> str:
    """The JSON to publish: `{"stamp": ns, "frame", "tracks": [{"id", "x", "y", "z", "age"}]}`, in m and s."""
    entries = [
        {"id": t.id, "x": round(t.x, 3), "y": round(t.y, 3), "z": round(t.z, 3), "age": round(t.age_seconds, 3)}
        for t in tracks
    ]
    return json.dumps({"stamp": poses.header.stamp, "frame": poses.header.frame, "tracks": entries})
