"""The event detector's process: operator and recording use alike, as its settings say.

    python3 -m robotkube.entrypoints.detector

Inputs (docs/reference/contracts.md): `config.yaml`, watched through the API when ROBOTKUBE_CONFIGMAP names it; for
recordings NODE_NAME, the mounted Secret `database` and the claim at ROBOTKUBE_RECORDINGS (default
/var/lib/robotkube/recordings). Port 8081: health, /input, /events.

The order of the start is chosen for the time from an event to the first stored message: subscriptions first, then what
imports and connects (database, segments, API server), each on a thread of its own.
"""

from __future__ import annotations

import json
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robotkube.adapters.health_http import HealthServer
from robotkube.adapters.ros_rclpy import MessageTypeError, RosNode, RosSubscription
from robotkube.domain.demands import renewal
from robotkube.domain.detector_settings import (
    DetectorSettings,
    RecordingReaction,
    TopicSettings,
    read_detector_settings,
)
from robotkube.domain.errors import DocumentError, InputError, RefusalError, UnavailableError
from robotkube.domain.recording_plans import RecordedTopic, RecordingPlan
from robotkube.domain.texts import read_mapping
from robotkube.entrypoints.following import follow_settings, ownership_of
from robotkube.entrypoints.processes import PodSettings, Process, read_text, run
from robotkube.services.event_detector import EventDetector
from robotkube.services.operator_reactions import OperatorReactions
from robotkube.services.ownership import Ownership
from robotkube.services.recording.places import RecorderPlace
from robotkube.services.recording.recordings import Recordings

if TYPE_CHECKING:
    from robotkube.adapters.kubernetes_http import ApiServer, ConfigMapWatch
    from robotkube.ports.recordings import Claim, RecordingStore

DRAIN_SECONDS = 0.02
LAST_DRAIN_SECONDS_MAX = 0.5
STORE_SECONDS_MAX = 5.0
LEAVE_SECONDS_MAX = 1.0
GRACE_SECONDS = 9.0
CONFIG_KEY = "config.yaml"
RECORDINGS_FOLDER = "/var/lib/robotkube/recordings"
TASKS = ("robotkube.io", "v1alpha1", "taskdescriptions")


def main() -> None:
    """Run until SIGTERM; exit codes as in `processes`."""
    run("event-detector", body, GRACE_SECONDS)


def body(process: Process) -> None:
    """Start, receive until the process shall end, then store what was received."""
    _log_through(process)
    pod = PodSettings.from_environment()
    settings = _settings(read_text(pod.config_file, "the detector's settings"), str(pod.config_file))
    node, ownership = RosNode("event_detector"), ownership_of(pod)
    detector = EventDetector(
        Live(node),
        lambda settings: make_operator(settings, pod, ownership),
        lambda reaction, settings: make_recordings(reaction, settings, pod, ownership),
        time.time_ns,
        time.monotonic,
    )
    detector.apply(settings)
    process.log("subscribed", name=settings.name, subscriptions=detector.subscribed, seconds=_process_age_seconds())
    server = HealthServer(
        live=lambda: next((one.failed for one in detector.recordings if one.failed), None),
        ready=lambda: detector.not_ready or None,
        metrics=lambda: metrics(detector) + ownership.metrics(),
        pages={
            "/input": lambda: json.dumps(detector.input_document()),
            "/events": lambda: json.dumps(detector.events_document()),
        },
        port=pod.health_port,
    )
    server.start()
    changes: deque[str] = deque(maxlen=1)
    watch = _watch(pod, changes, process, ownership)
    _receive(process, detector, changes)
    if watch is not None:
        watch.stop()
    _end(process, detector)
    _leave(node)


def _leave(node: RosNode) -> None:
    """Say goodbye to the publishers, or they wait 20 s for a reader that is gone. The middleware may hang here."""
    thread = threading.Thread(target=node.close, name="leave", daemon=True)
    thread.start()
    thread.join(LEAVE_SECONDS_MAX)


def _receive(process: Process, detector: EventDetector, changes: deque[str]) -> None:
    ready = False
    while not process.stopping.wait(DRAIN_SECONDS):
        if changes:
            _change(process, detector, changes.popleft())
        detector.turn()
        if not ready and not detector.not_ready:
            ready = True
            process.log("ready", seconds=_process_age_seconds())


def _change(process: Process, detector: EventDetector, text: str) -> None:
    """Apply changed settings; refused ones are reported and the present ones stay."""
    try:
        ended = detector.apply(_settings(text, CONFIG_KEY))
    except InputError as error:
        process.log("settings refused", error=str(error))
        return
    for recordings in ended:
        recordings.stop(STORE_SECONDS_MAX)


def _end(process: Process, detector: EventDetector) -> None:
    """Go on for as long as the recordings ask for, take what has arrived already, then store everything."""
    end = time.monotonic() + detector.after_seconds
    while time.monotonic() < end:
        time.sleep(DRAIN_SECONDS)
        detector.turn()
    deadline = time.monotonic() + LAST_DRAIN_SECONDS_MAX
    while detector.turn() and time.monotonic() < deadline:
        time.sleep(DRAIN_SECONDS)
    complete = [recordings.stop(STORE_SECONDS_MAX) for recordings in detector.recordings]
    process.log("stopped", recordings=len(complete), complete=all(complete))


class Live:
    """The ROS graph for the detector's service."""

    def __init__(self, node: RosNode) -> None:
        self._node = node

    def subscribe(self, topic: str, settings: TopicSettings) -> LiveTopic:
        """Subscribe; DocumentError names the topic and what ROS has against it."""
        try:
            return LiveTopic(
                self._node.subscribe(topic, settings.type, settings.reliability, settings.durability, settings.depth)
            )
        except (MessageTypeError, InputError) as error:
            raise DocumentError(f"topic {topic}", [str(error)]) from error

    def visible(self) -> Mapping[str, Sequence[str]]:
        """Topic -> types."""
        return self._node.topics()


class LiveTopic:
    """A subscription for the detector's service."""

    lost = 0

    def __init__(self, subscription: RosSubscription) -> None:
        self._subscription = subscription

    def drain(self, messages_max: int) -> Sequence[tuple[bytes, int]]:
        """What waits, with the time of this call as the time of reception."""
        messages = self._subscription.take(messages_max)
        if not messages:
            return ()
        now = time.time_ns()
        return [(message, now) for message in messages]

    def close(self) -> None:
        """Unsubscribe."""
        self._subscription.close()


class ApiTasks:
    """The TaskDescriptions of one namespace over the API server. Nothing is written while the process is not sure that
    its release is still its own: UnavailableError."""

    def __init__(self, api: ApiServer, namespace: str, ownership: Ownership) -> None:
        self._api, self._namespace, self._ownership = api, namespace, ownership

    def tasks(self) -> Sequence[Mapping[str, Any]]:
        """All of them."""
        found = self._api.get(self._path()) or {}
        return list(found.get("items", []))

    def create(self, task: Mapping[str, Any]) -> None:
        """Make the object; RefusalError carries the server's words."""
        self._check()
        try:
            self._api.create(self._path(), task)
        except InputError as error:
            raise RefusalError("Refused", str(error)) from error

    def renew(self, name: str, now: int) -> bool:
        """Patch the annotation."""
        self._check()
        try:
            return self._api.patch(self._path(name), renewal(now))
        except InputError as error:
            raise RefusalError("Refused", str(error)) from error

    def delete(self, name: str) -> None:
        """Delete the object."""
        self._check()
        try:
            self._api.delete(self._path(name))
        except InputError as error:
            raise RefusalError("Refused", str(error)) from error

    def _check(self) -> None:
        if not self._ownership.sure:
            raise UnavailableError("the settings have to be read anew first: another node may run this release by now")

    def _path(self, name: str = "") -> str:
        from robotkube.adapters.kubernetes_http import custom_path

        group, version, plural = TASKS
        return custom_path(group, version, self._namespace, plural, name)


def make_operator(settings: DetectorSettings, pod: PodSettings, ownership: Ownership) -> OperatorReactions:
    """The started operator reaction; its tasks are in the namespace of the pod's ConfigMap."""
    from robotkube.adapters.kubernetes_http import ApiServer, split_name

    namespace, _ = split_name(pod.config_map or settings.name)
    tasks = ApiTasks(ApiServer.from_environment(os.environ), namespace, ownership)
    reactions = OperatorReactions(settings.name, namespace, tasks, time.time_ns, time.monotonic, settings.task)
    reactions.start()
    return reactions


def make_recordings(
    reaction: RecordingReaction, settings: DetectorSettings, pod: PodSettings, ownership: Ownership
) -> Recordings:
    """The started recording reaction."""
    if not pod.node:
        raise InputError("NODE_NAME is not set; a recording's index names the node: set it from spec.nodeName")
    root = Path(os.environ.get("ROBOTKUBE_RECORDINGS", RECORDINGS_FOLDER))
    place = RecorderPlace(
        volume=f"{pod.node}/{reaction.volume}",
        open_store=lambda: _open_store(pod),
        open_claim=lambda: _open_claim(root, reaction.recording),
        clock_ns=time.time_ns,
        monotonic=time.monotonic,
        ownership=ownership,
    )
    recordings = Recordings(recording_plan(reaction, settings), place, {})
    recordings.start()
    return recordings


def recording_plan(reaction: RecordingReaction, settings: DetectorSettings) -> RecordingPlan:
    """What the reaction asks for, with what the settings say of its topics."""
    topics = tuple(
        RecordedTopic(topic.pattern, topic.type, reaction.storage[topic.pattern.text], latched=topic.latched)
        for topic in settings.topics
        if topic.pattern.text in reaction.storage
    )
    return RecordingPlan(
        rule=reaction.rule,
        recording=reaction.recording,
        volume=reaction.volume,
        topics=topics,
        after_seconds=reaction.after_seconds,
        trace=reaction.trace,
        provenance=reaction.provenance,
    )


def _open_store(pod: PodSettings) -> RecordingStore:
    from robotkube.adapters.mongodb_pymongo import PymongoRecordingStore, connect, read_account

    return PymongoRecordingStore(connect(read_account(pod.database_folder)))


def _open_claim(root: Path, owner: str) -> Claim:
    from robotkube.entrypoints.claims import VolumeClaim

    return VolumeClaim(root, owner, time.time_ns)


def _settings(text: str, where: str) -> DetectorSettings:
    return read_detector_settings(read_mapping(text, where), where)


def _watch(pod: PodSettings, changes: deque[str], process: Process, ownership: Ownership) -> ConfigMapWatch | None:
    if pod.config_map is None:
        return None

    def take(data: Mapping[str, str]) -> None:
        if CONFIG_KEY in data:
            changes.append(data[CONFIG_KEY])

    return follow_settings(process, pod.config_map, ownership, take)


def metrics(detector: EventDetector) -> str:
    """The detector's numbers in Prometheus' text format; one series per topic and per recording."""
    lines = ["# TYPE robotkube_detector_received_total counter"]
    for name, topic in detector.input_document()["topics"].items():
        lines.append(f'robotkube_detector_received_total{{topic="{name}"}} {topic["received"]}')
    edges = detector.events_document()["events"]
    lines += ["# TYPE robotkube_detector_edges gauge", f"robotkube_detector_edges {len(edges)}"]
    for recordings in detector.recordings:
        label = f'recording="{recordings.plan.recording}"'
        lines.append(f"robotkube_recorder_waiting_writes{{{label}}} {recordings.waiting}")
        for key, value in recordings.counts().items():
            lines.append(f"robotkube_recorder_{key}_total{{{label}}} {value}")
    return "\n".join(lines) + "\n"


def _process_age_seconds() -> float:
    """Seconds since the kernel started this process: what a start costs, interpreter and imports included."""
    ticks = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
    return round(time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK"), 3)


class _ThroughProcess(logging.Handler):
    """Sends the services' log records through the process's log."""

    def __init__(self, process: Process) -> None:
        super().__init__()
        self._process = process

    def emit(self, record: logging.LogRecord) -> None:
        self._process.log(record.getMessage(), level=record.levelname.lower())


def _log_through(process: Process) -> None:
    logger = logging.getLogger("robotkube")
    logger.setLevel(logging.INFO)
    logger.addHandler(_ThroughProcess(process))
    logger.propagate = False


if __name__ == "__main__":
    main()
