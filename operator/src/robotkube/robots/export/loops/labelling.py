"""Labelling for collective learning: the clouds of a bag with labels made of the other agents' poses.

The bag is read twice: first poses and transforms, which are small and are all kept; then cloud by cloud.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from robotkube.errors import InputError
from robotkube.robots.bags.ports.sources import BagSource
from robotkube.robots.export.core.labels import AgentPoses, Label, LabellingSettings, points_within
from robotkube.robots.export.core.transforms import PoseHistory, StaticTransforms, deviation, transform
from robotkube.robots.perception.core.messages import CLOUD_TYPE
from robotkube.robots.perception.core.point_clouds import Cloud, read_cloud
from robotkube.robots.ros.core.cdr_readers.readers import FieldReader, Layouts
from robotkube.robots.ros.core.topic_patterns import TopicPattern, ros_name

POSES_DEFAULT = "/vehicles/{agent}/pose"
POSES_MAX = 10_000_000
POSE_VALUES = 7
FRAMES_MAX = 10
TRANSFORM_TYPES = {"geometry_msgs/msg/TransformStamped": "", "tf2_msgs/msg/TFMessage": "transforms[]."}
_POSE_PATHS = (("pose", ()), ("pose.pose", ("pose.covariance",)), ("pose.pose", ()))
"""The fields in which a pose may stand, and its covariance."""
_AXES = (*(f"translation.{axis}" for axis in "xyz"), *(f"rotation.{axis}" for axis in "xyzw"))


@dataclass(frozen=True)
class LabelledCloud:
    """A cloud with its labels, none when nobody was near."""

    topic: str
    cloud: Cloud
    labels: tuple[Label, ...]


@dataclass
class LabellingCounts:
    """The counters of a labelling. `unlocated`: clouds whose sensor's place nobody knows; they are left out, as are
    messages that are `unreadable`. `frames`: of the sensors that no transform joins to a vehicle."""

    clouds: int = 0
    unlocated: int = 0
    unreadable: int = 0
    boxes: int = 0
    problems: list[str] = field(default_factory=list)
    frames: set[str] = field(default_factory=set)


def label_clouds(
    bag: BagSource, layouts: Layouts, settings: LabellingSettings, counts: LabellingCounts, poses: str = POSES_DEFAULT
) -> Iterator[LabelledCloud]:
    """Every cloud whose sensor's place is known, in the order of the times. `poses`: pattern of the pose topics.

    InputError when the bag has no poses of two agents or no clouds."""
    types = bag.types
    clouds = {name for name, kind in types.items() if kind == CLOUD_TYPE}
    agents = _agent_poses(bag, types, layouts, TopicPattern(poses), counts)
    if not clouds or len(agents.paths) < 2:
        raise InputError(
            f"labels need clouds and the poses of at least two: the bag has {len(clouds)} topics of {CLOUD_TYPE} and "
            f"poses of {', '.join(sorted(agents.paths)) or 'nobody'} on {poses}; record them together"
        )
    for topic, _, data in bag.messages(clouds):
        try:
            cloud = read_cloud(data)
        except ValueError:
            counts.unreadable += 1
            continue
        frame = cloud.header.frame.lstrip("/")
        labels = agents.labels(frame, cloud.header.stamp, settings)
        if labels is None:
            counts.unlocated += 1
            if len(counts.frames) < FRAMES_MAX and not agents.knows(frame):
                counts.frames.add(frame)
            continue
        counted = tuple(replace(label, points=len(points_within(label, cloud))) for label in labels)
        counts.clouds += 1
        counts.boxes += len(counted)
        yield LabelledCloud(topic, cloud, counted)


def _agent_poses(
    bag: BagSource, types: Mapping[str, str], layouts: Layouts, pattern: TopicPattern, counts: LabellingCounts
) -> AgentPoses:
    agents = {name: agent for name in types if (agent := pattern.agent(name))}
    readers: dict[str, Callable[[bytes], None]] = {}
    paths: dict[str, PoseHistory] = {}
    mounts = StaticTransforms()
    for name, agent in agents.items():
        reader = _pose_reader(layouts, types[name], counts)
        if reader is not None:
            path = paths[agent] = PoseHistory()
            readers[name] = _pose_receiver(path, reader)
    for name, kind in types.items():
        if kind in TRANSFORM_TYPES:
            readers[name] = _transform_receiver(mounts, layouts, kind)
    for number, (name, _, data) in enumerate(bag.messages(set(readers))):
        if number >= POSES_MAX:
            raise InputError(f"more than {POSES_MAX} poses and transforms; export a part with --from and --to")
        try:
            readers[name](data)
        except ValueError:
            counts.unreadable += 1
    moving = {agent: path for agent, path in paths.items() if path.poses}
    return AgentPoses(moving, mounts, {ros_name(agent): agent for agent in moving})


def _pose_reader(layouts: Layouts, type_name: str, counts: LabellingCounts) -> FieldReader | None:
    problem = ""
    for pose, covariance in _POSE_PATHS:
        axes = [f"{pose}.position.{axis}" for axis in "xyz"] + [f"{pose}.orientation.{axis}" for axis in "xyzw"]
        try:
            return layouts.reader(type_name, ["header.stamp", "header.frame_id", *axes, *covariance])
        except ValueError as error:
            problem = problem or str(error)
    counts.problems.append(f"{type_name} has no pose: {problem}")
    return None


def _pose_receiver(path: PoseHistory, reader: FieldReader) -> Callable[[bytes], None]:
    def receive(data: bytes) -> None:
        stamp, frame, *values = reader(data)
        pose = transform(values[:POSE_VALUES])
        path.frame = path.frame or frame
        if pose is None or frame != path.frame:
            raise ValueError(f"a pose in frame {frame}, or of no numbers")
        path.add(stamp, pose, deviation(values[POSE_VALUES]) if len(values) > POSE_VALUES else None)

    return receive


def _transform_receiver(mounts: StaticTransforms, layouts: Layouts, type_name: str) -> Callable[[bytes], None]:
    before = TRANSFORM_TYPES[type_name]
    names = ["header.frame_id", "child_frame_id", *(f"transform.{axis}" for axis in _AXES)]
    reader = layouts.reader(type_name, [f"{before}{name}" for name in names])

    def receive(data: bytes) -> None:
        values: Sequence[Any] = reader(data)
        rows = zip(*values, strict=True) if before else [values]
        for parent, child, *numbers in rows:
            mount = transform(numbers)
            if mount is not None:
                mounts.add(str(parent).lstrip("/"), str(child).lstrip("/"), mount)

    return receive
