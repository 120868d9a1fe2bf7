"""Windows: the view of the buffers that plugins get. Public API of rules that are written in Python.

    window.latest("/vehicles/vehicle_00/pose", ["pose.position.x"]).values[0]          # metres
    window.latest_per_agent("/vehicles/{agent}/pose", ["pose.position.x"])["vehicle-00"]
    window.at("/vehicles/vehicle_00/pose", stamp, ["pose.position.x", "pose.position.y"])
    window.pose_at("/vehicles/vehicle_00/pose", stamp).orientation                      # x, y, z, w
    column = window.range(topic, first, last, ["pose.position.x"])["pose.position.x"]
    numpy.frombuffer(column, column.typecode)

Topics are full ROS names, patterns hold `{agent}`, agents are names such as `vehicle-00`. Fields are paths as in
`robotkube.robots.ros.core.cdr_readers`; units are those of the message type. Stamps are ints, ns since 1970: when a
message was measured by its header, else received. A topic nobody subscribed to has no messages; a wrong field is a
ValueError. Messages that cannot be read are left out. Every method may be called from any thread and takes a snapshot.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from robotkube.robots.ros.core.cdr_readers.readers import NUMBER, FieldReader, Layouts
from robotkube.robots.ros.core.geometry import Quaternion, _unit, slerp
from robotkube.robots.ros.core.ring_buffers import RingBuffer, Sample
from robotkube.robots.ros.core.topic_patterns import TopicPattern

GAP_SECONDS = 1.0
UNREADABLE_PASSED_MAX = 10


_POSE_FIELDS = (("position", "orientation"), ("translation", "rotation"))
_stamp = attrgetter("stamp")
_ReadSample = tuple[Sample, tuple[Any, ...]]
_Around = tuple[_ReadSample, _ReadSample, float]


@dataclass(frozen=True, slots=True)
class Reading:
    """The values of a message's fields, or between two messages, in the order of the requested fields; `stamp` in
    ns."""

    stamp: int
    values: tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class Pose:
    """A pose at `stamp` (ns): `position` x, y, z in metres, `orientation` x, y, z, w of length 1."""

    stamp: int
    position: tuple[float, float, float]
    orientation: Quaternion


@dataclass(frozen=True, slots=True)
class Columns:
    """Messages as columns of equal length, in the order of `stamps` (int64, ns); `received` likewise.

    `columns`: field -> array.array for numbers (the message's own type) and bools (0 and 1 as unsigned bytes), which
    `numpy.frombuffer` reads without a copy when it is given the dtype of `typecode`; a list for texts and series.
    """

    stamps: array[int]
    received: array[int]
    columns: Mapping[str, Any]

    def __len__(self) -> int:
        return len(self.stamps)

    def __getitem__(self, field: str) -> Any:
        """The column of a field; KeyError when it was not requested."""
        return self.columns[field]


class Window:
    """A view on `buffers` (topic -> buffer); `patterns`: topic pattern -> message type, as in the settings."""

    def __init__(self, buffers: Mapping[str, RingBuffer], patterns: Mapping[str, str], layouts: Layouts) -> None:
        self._buffers = buffers
        self._layouts = layouts
        self._patterns = [(TopicPattern(text), type_name) for text, type_name in patterns.items()]
        self._types: dict[str, str] = {}

    def topics(self, pattern: str) -> Mapping[str, str]:
        """Agent -> its topic, for the topics of a pattern that have messages; agent `""` without `{agent}`."""
        fits = TopicPattern(pattern)
        agents = ((fits.agent(topic), topic) for topic, buffer in list(self._buffers.items()) if len(buffer))
        return {agent: topic for agent, topic in agents if agent is not None}

    def latest(self, topic: str, fields: Sequence[str]) -> Reading | None:
        """The fields of the newest message; None without one."""
        return _last(self._samples(topic), self._reader(topic, fields))

    def latest_per_agent(self, pattern: str, fields: Sequence[str]) -> Mapping[str, Reading]:
        """Agent -> its newest message on the pattern's topic; agents without one are left out."""
        readings = {agent: self.latest(topic, fields) for agent, topic in self.topics(pattern).items()}
        return {agent: reading for agent, reading in readings.items() if reading is not None}

    def before(self, topic: str, stamp: int, fields: Sequence[str]) -> Reading | None:
        """The fields of the last message at `stamp` or before it; None without one."""
        samples = self._samples(topic)
        end = bisect_right(samples, stamp, key=_stamp)
        return _last(samples[:end], self._reader(topic, fields))

    def at(self, topic: str, stamp: int, fields: Sequence[str], gap_seconds: float = GAP_SECONDS) -> Reading | None:
        """Fields at a time: numbers linear between the messages around it, anything else from the one before it.

        None outside the messages, and between two that are more than `gap_seconds` apart: nothing is extrapolated.
        Quaternions are not numbers to be mixed one by one: see `pose_at`.
        """
        reader = self._reader(topic, fields)
        around = self._around(topic, stamp, reader, gap_seconds)
        if around is None:
            return None
        (_, values), (_, others), share = around
        mixed = (
            a + (b - a) * share if kind == NUMBER and share else a
            for a, b, kind in zip(values, others, reader.kinds, strict=True)
        )
        return Reading(stamp, tuple(mixed))

    def pose_at(self, topic: str, stamp: int, path: str = "pose", gap_seconds: float = GAP_SECONDS) -> Pose | None:
        """The pose (or transform) that stands at `path`, at a time: position linear, orientation on the great circle.

        None as for `at`. ValueError when the type has no pose there. An orientation of length 0, which many senders
        leave there, counts as no rotation (0, 0, 0, 1).
        """
        reader = self._pose_reader(topic, path)
        around = self._around(topic, stamp, reader, gap_seconds)
        if around is None:
            return None
        (_, a), (_, b), share = around
        x, y, z = (p + (q - p) * share for p, q in zip(a[:3], b[:3], strict=True))
        return Pose(stamp, (x, y, z), slerp(_unit(a[3:]), _unit(b[3:]), share))

    def range(self, topic: str, first: int, last: int, fields: Sequence[str]) -> Columns:
        """The messages with stamps from `first` to `last`, both included."""
        reader = self._reader(topic, fields)
        buffer = self._buffers.get(topic)
        messages = list(_readable(buffer.between(first, last) if buffer else (), reader))
        columns = {
            path: _column(code, [values[index] for _, values in messages])
            for index, (path, code) in enumerate(zip(reader.paths, reader.codes, strict=True))
        }
        stamps = array("q", (s.stamp for s, _ in messages))
        received = array("q", (s.received for s, _ in messages))
        return Columns(stamps, received, columns)

    def join(
        self, agents: Sequence[str], pattern: str, stamp: int, fields: Sequence[str], gap_seconds: float = GAP_SECONDS
    ) -> Mapping[str, Reading]:
        """Agent -> its fields at one and the same time, as `at`; agents that have nothing there are left out."""
        fits = TopicPattern(pattern)
        readings = {agent: self.at(fits.topic(agent), stamp, fields, gap_seconds) for agent in agents}
        return {agent: reading for agent, reading in readings.items() if reading is not None}

    def _samples(self, topic: str) -> Sequence[Sample]:
        buffer = self._buffers.get(topic)
        return buffer.samples() if buffer is not None else ()

    def _type(self, topic: str) -> str:
        if topic not in self._types:
            types = (type_name for pattern, type_name in self._patterns if pattern.agent(topic) is not None)
            self._types[topic] = next(types, "")
        if not self._types[topic]:
            raise ValueError(f"{topic} fits no topic pattern of the settings")
        return self._types[topic]

    def _reader(self, topic: str, fields: Sequence[str]) -> FieldReader:
        return self._layouts.reader(self._type(topic), tuple(fields))

    def _pose_reader(self, topic: str, path: str) -> FieldReader:
        prefix = f"{path}." if path else ""
        problem = None
        for position, orientation in _POSE_FIELDS:
            paths = [f"{prefix}{position}.{axis}" for axis in "xyz"] + [f"{prefix}{orientation}.{a}" for a in "xyzw"]
            try:
                return self._reader(topic, paths)
            except ValueError as error:
                problem = problem or error
        raise ValueError(f"{topic} has no pose at {path!r}: {problem}")

    def _around(self, topic: str, stamp: int, reader: FieldReader, gap_seconds: float) -> _Around | None:
        samples = self._samples(topic)
        end = bisect_right(samples, stamp, key=_stamp)
        before = _first(samples[max(end - UNREADABLE_PASSED_MAX, 0) : end][::-1], reader)
        if before is None:
            return None
        if before[0].stamp == stamp:
            return before, before, 0.0
        behind = _first(samples[end : end + UNREADABLE_PASSED_MAX], reader)
        if behind is None or behind[0].stamp - before[0].stamp > gap_seconds * 1e9:
            return None
        return before, behind, (stamp - before[0].stamp) / (behind[0].stamp - before[0].stamp)


def _readable(samples: Sequence[Sample], reader: FieldReader) -> Iterator[_ReadSample]:
    for sample in samples:
        try:
            yield sample, reader(sample.data)
        except ValueError:
            continue


def _first(samples: Sequence[Sample], reader: FieldReader) -> _ReadSample | None:
    return next(_readable(samples, reader), None)


def _last(samples: Sequence[Sample], reader: FieldReader) -> Reading | None:
    newest = _first(samples[-UNREADABLE_PASSED_MAX:][::-1], reader)
    return Reading(newest[0].stamp, newest[1]) if newest else None


def _column(code: str, values: Sequence[Any]) -> Any:
    if code == "?":
        return array("B", values)
    return array(code, values) if code else list(values)
