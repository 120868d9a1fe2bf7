"""The walk of a pose to an event: a detector with a rule about two vehicles, the second of which comes near."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

from ci.reference.walks.recording import Route, WalkRecorder
from robotkube.robots.detector.adapters.ros_topics import RosTopics
from robotkube.robots.detector.core.settings import read_detector_settings
from robotkube.robots.detector.loops.detector import EventDetector
from robotkube.robots.detector.loops.dispatching import Dispatcher
from robotkube.robots.detector.loops.recording import RecordingReactions
from robotkube.robots.reactions.loops.operator import EventRecord, OperatorReactions
from robotkube.robots.reactions.ports.deliveries import RunningReaction
from robotkube.robots.recording.loops.recordings import Recordings
from robotkube.robots.ros.adapters.rclpy_node import RosNode, RosSubscription
from robotkube.robots.ros.core.cdr_readers.readers import Layouts
from robotkube.robots.ros.core.qos import PublisherOffer
from robotkube.robots.rules.core import Edge, Message
from robotkube.robots.rules.core.messages import MemberChange, MessageValues
from robotkube.robots.rules.loops.workers import RuleWorkers

POSE = "geometry_msgs/msg/PoseStamped"
START_NS = 1_795_250_000_000_000_000
DEFINITION = """std_msgs/Header header
Pose pose
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: geometry_msgs/Pose
Point position
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
"""
SETTINGS: Mapping[str, Any] = {
    "name": "cloud-0/event-detector",
    "topics": [{"name": "/vehicles/{agent}/pose", "type": POSE}],
    "rules": [
        {
            "name": "near",
            "kind": "proximity",
            "agents": ["vehicle-00", "vehicle-01"],
            "topic": "/vehicles/{agent}/pose",
            "start_distance_m": 400,
            "stop_distance_m": 500,
        }
    ],
}


class Middleware:
    """What lies below the node of ROS in a process: it holds what was published until it is asked for."""

    def __init__(self) -> None:
        self.waiting: dict[int, list[bytes]] = {}

    def take_sent(self, address: int, messages_max: int) -> list[tuple[bytes, int, int, int]]:
        """The messages that wait, each with the times of its coming and sending, and its number."""
        waiting = self.waiting.pop(address, [])
        return [(data, START_NS, START_NS, number) for number, data in enumerate(waiting)]


class Handle:
    """A subscription of the middleware."""

    def __init__(self, pointer: int) -> None:
        self.pointer = pointer

    def __enter__(self) -> None:
        """Keep it in use."""

    def __exit__(self, *error: object) -> None:
        """Let it go."""

    def get_publisher_count(self) -> int:
        """One."""
        return 1


class WalkedNode(RosNode):
    """The node of ROS on that middleware, which gives subscriptions numbers in their order."""

    def __init__(self) -> None:
        self.middleware = Middleware()
        self.count = 0

    def subscribe(self, topic: str, *settings: Any, **more: Any) -> RosSubscription:
        """Subscribe, as on the real one."""
        self.count += 1
        return RosSubscription(topic, Handle(self.count), self.middleware, {})

    def offers(self, topic: str) -> list[PublisherOffer]:
        """No publisher is known."""
        return []

    def topics(self) -> dict[str, list[str]]:
        """No topic is known."""
        return {}


def route() -> Route:
    """The forms of a pose."""
    forms = (Message, MessageValues, MemberChange, Edge, EventRecord)
    return Route(forms, EventRecord, {Middleware: ()}, (Middleware.take_sent,))


def run(recorder: WalkRecorder) -> None:
    """Have the first vehicle stand, and record the pose with which the second one is near."""
    node = WalkedNode()
    detector = EventDetector(
        lambda name: RosTopics(node),
        Layouts({POSE: DEFINITION}.__getitem__),
        Dispatcher(_no_operator, _no_reaction, lambda: START_NS),
        RecordingReactions(_no_recordings),
        _no_workers,
        lambda: START_NS,
        lambda: 0.0,
    )
    detector.apply(read_detector_settings(SETTINGS, "walk"))
    node.middleware.waiting[1] = [pose(START_NS, 0.0)]
    detector.turn()
    node.middleware.waiting[2] = [pose(START_NS, 399.0)]
    with recorder.recording():
        detector.turn()


def pose(stamp_ns: int, x: float) -> bytes:
    """A serialised PoseStamped."""
    head = struct.pack("<iII4s", *divmod(stamp_ns, 1_000_000_000), 4, b"map\0")
    return b"\0\1\0\0" + head + struct.pack("<3d", x, 0.0, 0.0)


def _no_operator(settings: object, box: object) -> OperatorReactions:
    raise AssertionError("the settings ask for no task")


def _no_reaction(settings: object, box: object) -> RunningReaction:
    raise AssertionError("the settings ask for no delivery")


def _no_recordings(plan: object, buffers: object) -> Recordings:
    raise AssertionError("the settings ask for no recording")


def _no_workers() -> RuleWorkers:
    raise AssertionError("the rule needs no process of its own")
