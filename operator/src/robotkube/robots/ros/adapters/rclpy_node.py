"""ROS 2 topics as serialised messages, on the bindings below rclpy's Node.

Why not rclpy.Node, executors and message classes: they cost most of what a small process costs. A node object opens six
more DDS entities, a message package imports numpy, an executor spends 200 us per message. Here a process has a context,
one node without services, and per topic one publisher or subscription that moves bytes (CDR with its encapsulation).
Measurements: docs/decisions/0004-data-path.md.

    node = RosNode("bridge")         # one per process; ROS_DOMAIN_ID comes from the environment
    poses = node.subscribe("/p", "geometry_msgs/msg/PoseStamped", depth=1000)
    for data in poses.take(500): ...              # never blocks; call it every 20 to 40 ms
    out = node.advertise("/q", "geometry_msgs/msg/PoseStamped")
    out.publish(data)                             # any serialised message of that type

Nobody but the DDS library's own threads works in the background: what is not taken stays in the subscription's history
(`depth` messages; when it is full, the oldest goes).
"""

from __future__ import annotations

import importlib
import importlib.util
import logging
import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

from robotkube.errors import InputError, RobotKubeError, UnavailableError
from robotkube.foundation.documents.core.patterns import ROS_TYPE
from robotkube.robots.ros.adapters import unicast_discovery
from robotkube.robots.ros.adapters.network_links import wait_for_link
from robotkube.robots.ros.core.common_messages import PublishOutcome

if TYPE_CHECKING:  # only who reads the graph needs them
    from robotkube.robots.ros.core.graph import Endpoint
    from robotkube.robots.ros.core.qos import PublisherOffer

PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"  # the middleware's word until it knows a node's name
ENDLESS_NS = 1 << 62
INCOMPATIBLE, DEADLINE, LIVELINESS = "incompatible", "deadline", "liveliness"
POLICY_PREFIX = "RMW_QOS_POLICY_"
_WORD_START = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


log = logging.getLogger(__name__)


class MessageTypeError(InputError):
    """A message type that is not installed in this image."""


def message_type(name: str) -> Any:
    """The bindings' handle of a type such as geometry_msgs/msg/PoseStamped: an object whose class holds the type
    support. The package's Python messages are not imported. MessageTypeError says what is wrong with `name`."""
    if not ROS_TYPE.fullmatch(name):
        raise MessageTypeError(f"type {name!r} is not written like geometry_msgs/msg/PoseStamped")
    package, _, message = name.partition("/msg/")
    support = _type_support_module(package, name)
    attribute = f"type_support_msg__msg__{_WORD_START.sub('_', message).lower()}"
    if not hasattr(support, attribute):
        raise MessageTypeError(f"type {name}: package {package} has no message {message}; see its documentation")
    metaclass = type("Type", (type,), {"_TYPE_SUPPORT": getattr(support, attribute)})
    return metaclass(message, (), {})


def missing_type(name: str) -> str:
    """Why the type is not installed in this image; empty when it is."""
    try:
        message_type(name)
    except MessageTypeError as error:
        return str(error)
    return ""


def _type_support_module(package: str, name: str) -> ModuleType:
    full_name = f"{package}.{package}_s__rosidl_typesupport_c"
    if full_name in sys.modules:
        return sys.modules[full_name]
    installed = importlib.util.find_spec(package)
    folders = list(installed.submodule_search_locations or ()) if installed else []
    libraries = [p for folder in folders for p in Path(folder).glob(f"{package}_s__rosidl_typesupport_c*.so")]
    if not libraries:
        raise MessageTypeError(f"type {name}: message package {package} is not installed in this image")
    spec = importlib.util.spec_from_file_location(full_name, libraries[0])
    assert isinstance(spec, ModuleSpec)
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.modules[full_name] = module
    return module


class RosNode:
    """A context with one node. `name` may hold letters, digits and underscores. All methods belong to one thread."""

    def __init__(self, name: str) -> None:
        _use_profile()
        missing = wait_for_link()
        if missing:
            log.warning("network link without carrier links=%s hears=nobody", ",".join(missing))
        self._bindings = _bindings()
        self._native = _native()
        self._context = self._bindings.Context([], self._bindings.RCL_DEFAULT_DOMAIN_ID)
        with self._context:
            self._node = self._bindings.Node(name, "/", self._context, [], False, False)
        self._discovery = unicast_discovery.start()

    def subscribe(
        self,
        topic: str,
        type_name: str,
        reliability: str = "reliable",
        durability: str = "volatile",
        depth: int = 1000,
        deadline_ns: int | None = None,
        liveliness: str = "automatic",
        lease_ns: int | None = None,
    ) -> RosSubscription:
        """A subscription; MessageTypeError for an unknown type, InputError for a topic name ROS refuses."""
        kind = message_type(type_name)
        qos_profile = self._qos_profile(reliability, durability, depth, deadline_ns, liveliness, lease_ns)
        with self._node:
            handle = self._make(lambda: self._bindings.Subscription(self._node, kind, topic, qos_profile), topic)
            kinds = self._bindings.rcl_subscription_event_type_t
            events = {INCOMPATIBLE: self._event(handle, kinds.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS)}
            if deadline_ns is not None:
                events[DEADLINE] = self._event(handle, kinds.RCL_SUBSCRIPTION_REQUESTED_DEADLINE_MISSED)
            if lease_ns is not None:
                events[LIVELINESS] = self._event(handle, kinds.RCL_SUBSCRIPTION_LIVELINESS_CHANGED)
        return RosSubscription(topic, handle, self._native, events)

    def advertise(
        self, topic: str, type_name: str, reliability: str = "reliable", durability: str = "volatile", depth: int = 1000
    ) -> RosPublisher:
        """A publisher; errors as in `subscribe`."""
        kind = message_type(type_name)
        qos_profile = self._qos_profile(reliability, durability, depth)
        with self._node:
            handle = self._make(lambda: self._bindings.Publisher(self._node, kind, topic, qos_profile), topic)
        return RosPublisher(topic, handle, self._bindings.RCLError)

    def publish_due(self, messages: Sequence[tuple[Any, int, bytes]], late_ns: int) -> PublishOutcome:
        """See the port; the publishers are this node's own."""
        addressed = [(publisher.address, due, data) for publisher, due, data in messages]
        published, late, refusal = self._native.publish_due(addressed, late_ns)
        return PublishOutcome(published, late, refusal or "")

    def topics(self) -> dict[str, list[str]]:
        """The topics that somebody publishes or subscribes to now, each with its message types."""
        with self._node:
            return dict(self._bindings.rclpy_get_topic_names_and_types(self._node, False))

    def endpoints(self) -> list[Endpoint]:
        """The publishers and subscriptions of all other nodes that are known now; those of topics, not of services."""
        ends = (
            ("out", self._bindings.rclpy_get_publishers_info_by_topic),
            ("in", self._bindings.rclpy_get_subscriptions_info_by_topic),
        )
        with self._node:
            own = (self._node.get_node_name(), self._node.get_namespace())
            return [
                _endpoint(topic, direction, entry)
                for topic in dict(self._bindings.rclpy_get_topic_names_and_types(self._node, False))
                for direction, ask in ends
                for entry in ask(self._node, topic, False)
                if (entry["node_name"], entry["node_namespace"]) != own
            ]

    def offers(self, topic: str) -> list[PublisherOffer]:
        """The publishers of a topic that are known now, with the QoS profiles that they offer."""
        with self._node:
            publishers = self._bindings.rclpy_get_publishers_info_by_topic(self._node, topic, False)
        return [_offer(entry) for entry in publishers]

    def close(self) -> None:
        """Leave the network. May hang in the middleware: a process calls it only under its shutdown deadline."""
        if self._discovery is not None:
            self._discovery.close()
        self._node.destroy_when_not_in_use()
        with self._context:
            self._context.shutdown()

    def _event(self, handle: Any, kind: Any) -> Any:
        """The middleware's own count of something; None where a middleware does not count it."""
        try:
            return self._bindings.EventHandle(handle, kind)
        except self._bindings.UnsupportedEventTypeError:
            return None

    def _make(self, factory: Callable[[], Any], topic: str) -> Any:
        try:
            return factory()
        except (ValueError, self._bindings.RCLError) as error:
            raise InputError(f"topic {topic}: ROS refuses it: {error}") from error

    def _qos_profile(
        self,
        reliability: str,
        durability: str,
        depth: int,
        deadline_ns: int | None = None,
        liveliness: str = "automatic",
        lease_ns: int | None = None,
    ) -> Any:
        from rclpy import qos
        from rclpy.duration import Duration

        optional: dict[str, Any] = {}
        if deadline_ns is not None:
            optional["deadline"] = Duration(nanoseconds=deadline_ns)
        if lease_ns is not None:
            optional["liveliness_lease_duration"] = Duration(nanoseconds=lease_ns)
        if liveliness != "automatic" or lease_ns is not None:
            optional["liveliness"] = qos.LivelinessPolicy[liveliness.upper()]
        profile: Any = qos.QoSProfile
        return profile(
            depth=depth,
            reliability=qos.ReliabilityPolicy[reliability.upper()],
            durability=qos.DurabilityPolicy[durability.upper()],
            **optional,
        ).get_c_qos_profile()


def _endpoint(topic: str, direction: str, entry: Mapping[str, Any]) -> Endpoint:
    from rclpy import qos

    from robotkube.robots.ros.core.graph import Endpoint

    profile = entry["qos_profile"]
    reliability = qos.ReliabilityPolicy(profile["reliability"]).name.lower()
    durability = qos.DurabilityPolicy(profile["durability"]).name.lower()
    return Endpoint(topic, direction, entry["topic_type"], reliability, durability, _node_of(entry))


def _node_of(entry: Mapping[str, Any]) -> str:
    node = f"{entry['node_namespace'].rstrip('/')}/{entry['node_name']}"
    return "" if UNKNOWN_NODE in node else node


def _offer(entry: Mapping[str, Any]) -> PublisherOffer:
    from rclpy import qos

    from robotkube.robots.ros.core.qos import PublisherOffer, QosProfile

    profile = entry["qos_profile"]
    qos_profile = QosProfile(
        qos.ReliabilityPolicy(profile["reliability"]).name.lower(),
        qos.DurabilityPolicy(profile["durability"]).name.lower(),
        _duration(profile["deadline"]),
        qos.LivelinessPolicy(profile["liveliness"]).name.lower(),
        _duration(profile["liveliness_lease_duration"]),
    )
    return PublisherOffer(_node_of(entry), entry["topic_type"], qos_profile)


def _duration(duration: Any) -> int | None:
    """A duration of the bindings in nanoseconds; None when it is endless."""
    nanoseconds = int(duration.nanoseconds)
    return nanoseconds if 0 < nanoseconds < ENDLESS_NS else None


class MessageIdentity(NamedTuple):
    """The identity of a message, the same for every subscription: when it was sent, ns since 1970, and its number in
    its publisher's sequence; None when the middleware does not number them."""

    time: int
    number: int | None


class RosSubscription:
    """Receives serialised messages of one topic."""

    def __init__(self, topic: str, handle: Any, native: Any, events: Mapping[str, Any]) -> None:
        self.topic = topic
        self._handle = handle
        self._native = native
        self._address = int(handle.pointer)
        self._events = {name: event for name, event in events.items() if event is not None}
        self._lost_liveliness = 0

    def take(self, messages_max: int = 1000) -> list[bytes]:
        """The messages that wait, in their order, at most `messages_max`; empty when none waits."""
        taken: list[bytes] = self._native.take(self._address, messages_max)
        return taken

    def take_timed(self, messages_max: int = 1000) -> tuple[list[tuple[bytes, int]], int | None]:
        """Take as `take` does, each with the time at which the middleware received it (ns since 1970), and the last
        one's number in its publisher's sequence; None without a message, or when the middleware does not number
        them."""
        taken: tuple[list[tuple[bytes, int]], int | None] = self._native.take_timed(self._address, messages_max)
        return taken

    def take_sent(self, messages_max: int = 1000) -> list[tuple[bytes, int, MessageIdentity]]:
        """Take as `take_timed` does, each with what tells it from every other message of the topic."""
        taken = self._native.take_sent(self._address, messages_max)
        return [(data, received, MessageIdentity(sent, number)) for data, received, sent, number in taken]

    @property
    def matched(self) -> int:
        """The number of publishers that are connected now."""
        with self._handle:
            return int(self._handle.get_publisher_count())

    def _status(self, name: str) -> Any:
        """The middleware's status of an event; None where it does not count it."""
        event = self._events.get(name)
        if event is None:
            return None
        with event:
            return event.take_event()

    @property
    def incompatible(self) -> tuple[int, str]:
        """The number of publishers that the middleware has refused because of their QoS profile so far, and the policy
        in which the last of them did not fit, such as durability."""
        status = self._status(INCOMPATIBLE)
        if status is None or not status.total_count:
            return 0, ""
        return int(status.total_count), status.last_policy_kind.name.removeprefix(POLICY_PREFIX).lower()

    @property
    def missed_deadlines(self) -> int:
        """The number of times that the requested deadline has passed without a message so far."""
        status = self._status(DEADLINE)
        return 0 if status is None else int(status.total_count)

    @property
    def lost_liveliness(self) -> int:
        """The number of publishers that were seen to give no sign of life for as long as the requested lease; one that
        fell silent and came back between two reads is not seen."""
        status = self._status(LIVELINESS)
        self._lost_liveliness += 0 if status is None else max(int(status.not_alive_count_change), 0)
        return self._lost_liveliness

    def close(self) -> None:
        """Stop receiving; what was not taken is gone."""
        self._address = 0
        for event in self._events.values():
            event.destroy_when_not_in_use()
        self._handle.destroy_when_not_in_use()


class RosPublisher:
    """Sends serialised messages on one topic."""

    def __init__(self, topic: str, handle: Any, failure: type[Exception]) -> None:
        self.topic = topic
        self.address = int(handle.pointer)
        self._handle = handle
        self._failure = failure
        self._publish = handle.publish_raw

    def publish(self, data: bytes) -> None:
        """Send one serialised message. UnavailableError when the middleware cannot accept it now."""
        try:
            self._publish(data)
        except self._failure as error:
            raise UnavailableError(f"topic {self.topic}: the middleware did not accept a message: {error}") from error

    @property
    def matched(self) -> int:
        """The number of subscriptions that are connected now."""
        with self._handle:
            return int(self._handle.get_subscription_count())

    def close(self) -> None:
        """Stop sending; what is not acknowledged yet is gone."""
        self.address = 0
        self._handle.destroy_when_not_in_use()


def _bindings() -> Any:
    """The bindings of rclpy."""
    try:
        from rclpy.impl.implementation_singleton import rclpy_implementation
    except ImportError as error:
        raise RobotKubeError(
            f"rclpy does not start ({error}); install the packages of operator/requirements/robot.txt"
        ) from error
    return rclpy_implementation


def _native() -> Any:
    """The compiled part: operator/native/robotkube_rcl.c."""
    try:
        return importlib.import_module("robotkube_rcl")
    except ImportError as error:
        raise RobotKubeError(
            f"robotkube_rcl does not start ({error}); compile it: operator/native/build PYTHON PREFIX"
        ) from error


def _use_profile() -> None:
    """Give Fast DDS the profile of this package unless the environment names another one."""
    if PROFILE_VARIABLE not in os.environ:
        profile = Path(__file__).parents[1] / "profiles" / "fastdds.xml"
        if profile.is_file():
            os.environ[PROFILE_VARIABLE] = str(profile)
