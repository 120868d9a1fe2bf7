"""A detector over topics and tasks in memory, with a clock of its own."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robotkube.errors import RefusalError, UnavailableError
from robotkube.robots.detector.core.settings import DetectorSettings, TopicSettings, read_detector_settings
from robotkube.robots.detector.loops.detector import EventDetector
from robotkube.robots.detector.loops.dispatching import Dispatcher
from robotkube.robots.detector.loops.recording import RecordingReactions
from robotkube.robots.detector.loops.status import DetectorStatus
from robotkube.robots.detector.ports import TopicInput
from robotkube.robots.reactions.core.settings import DeliveryReactionSettings
from robotkube.robots.reactions.loops.dead_letters import DeadLetterBox
from robotkube.robots.reactions.loops.operator import OperatorReactions
from robotkube.robots.ros.core.qos import IncompatiblePublishers, PublisherOffer, QosProfile, QosViolations
from tests.stages.detector.rules import layouts
from tests.stages.waiting import until

MS, SECOND = 1_000_000, 1_000_000_000
NOW = 1_795_250_000 * SECOND
ANSWER_SECONDS_MAX = 30.0


def pose(stamp: int, x: float, frame: bytes = b"map", order: str = "<") -> bytes:
    """A serialised PoseStamped."""
    body = struct.pack(f"{order}iII", stamp // 10**9, stamp % 10**9, len(frame) + 1) + frame + b"\0"
    body += bytes(-len(body) % 8) + struct.pack(f"{order}7d", x, 2.0, 3.0, 0, 0, 0, 1)
    return (b"\0\1\0\0" if order == "<" else b"\0\0\0\0") + body


class MemoryTopic:
    """Port TopicInput."""

    matched = 1

    def __init__(self, qos: QosProfile) -> None:
        self.lost = 0
        self.qos = qos
        self.incompatible = IncompatiblePublishers()
        self.violations = QosViolations()
        self.waiting: list[tuple[bytes, int]] = []
        self.closed = False

    def drain(self, messages_max: int) -> Sequence[tuple[bytes, int]]:
        messages, self.waiting = self.waiting[:messages_max], self.waiting[messages_max:]
        return messages

    def close(self) -> None:
        self.closed = True


class MemoryTopics:
    """Port LiveTopics."""

    def __init__(self) -> None:
        self.topics: dict[str, MemoryTopic] = {}
        self.published: dict[str, list[str]] = {}
        self.offered: dict[str, list[PublisherOffer]] = {}
        self.announced: list[str] = []

    def announce(self, topics: Sequence[TopicSettings]) -> None:
        self.announced = [topic.pattern.text for topic in topics]

    def subscribe(
        self, topic: str, settings: TopicSettings, qos: QosProfile, before: TopicInput | None = None
    ) -> MemoryTopic:
        fresh = self.topics[topic] = MemoryTopic(qos)
        if isinstance(before, MemoryTopic):
            fresh.waiting, fresh.lost = before.waiting, before.lost
            before.close()
        return fresh

    def visible(self) -> Mapping[str, Sequence[str]]:
        return self.published

    def offers(self, topic: str) -> Sequence[PublisherOffer]:
        return self.offered.get(topic, [])


class MemoryTasks:
    """Port OwnTasks; `away` makes every call fail that many times, `refusing` for ever; no call comes back while
    `answering` is cleared."""

    def __init__(self) -> None:
        self.objects: dict[str, Mapping[str, Any]] = {}
        self.renewals: list[tuple[str, int]] = []
        self.away = 0
        self.refusing = False
        self.creations = 0
        self.looks = 0
        self.answering = threading.Event()
        self.answering.set()

    def tasks(self) -> Sequence[Mapping[str, Any]]:
        self._answer()
        self.looks += 1
        return list(self.objects.values())

    def create(self, task: Mapping[str, Any]) -> None:
        self._answer()
        self.creations += 1
        self.objects.setdefault(task["metadata"]["name"], task)

    def renew(self, name: str, now: int) -> bool:
        self._answer()
        self.renewals.append((name, now))
        return name in self.objects

    def delete(self, name: str) -> None:
        self._answer()
        self.objects.pop(name, None)

    def _answer(self) -> None:
        assert self.answering.wait(ANSWER_SECONDS_MAX), "the caller waited for the answer"
        if self.refusing:
            raise RefusalError("Refused", "forbidden")
        if self.away > 0:
            self.away -= 1
            raise UnavailableError("API server: away")


class MemoryReaction:
    """Port Reaction: keeps what it is told."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.unreachable = ""
        self.told = list[Any]()
        self.stopped = False

    def react(self, delivery: Any) -> None:
        self.told.append(delivery)

    def counts(self) -> Mapping[str, int]:
        return {"delivered": len(self.told), "retries": 0, "dead": 0, "waiting": 0}

    def stop(self, seconds: float) -> bool:
        self.stopped = True
        return True


class DetectorStage:
    """A detector with its surroundings. `now` is the time of messages, `seconds` the monotonic time of leases."""

    def __init__(self, tasks: MemoryTasks, make_workers: Callable[[], Any] | None = None) -> None:
        self.live = MemoryTopics()
        self.tasks = tasks
        self.now = NOW
        self.seconds = 0.0
        self.operators: list[OperatorReactions] = []
        self.reactions: dict[str, Any] = {}
        self.recordings: list[Any] = []
        self.detector = EventDetector(
            lambda name: self.live,
            layouts(),
            Dispatcher(self._operator, self._reaction, lambda: self.now),
            RecordingReactions(self._recordings),
            make_workers or self._no_workers,
            lambda: self.now,
            lambda: (self.now - NOW) / 1e9,
        )
        self.status = DetectorStatus(self.detector, lambda: self.now)

    def _operator(self, settings: DetectorSettings, box: DeadLetterBox) -> OperatorReactions:
        reactions = OperatorReactions(
            settings.name, settings.agent, self.tasks, lambda: self.now, lambda: self.seconds, settings.task, box
        )
        self.operators.append(reactions)
        reactions.start()
        return reactions

    def _reaction(self, settings: DeliveryReactionSettings, box: DeadLetterBox) -> Any:
        return self.reactions.setdefault(settings.name, MemoryReaction(settings.name))

    def _recordings(self, plan: Any, buffers: Any) -> Any:
        self.recordings.append(MemoryRecordings(plan, buffers))
        return self.recordings[-1]

    @staticmethod
    def _no_workers() -> Any:
        raise AssertionError("no rule needs a process")

    def apply(self, document: Mapping[str, Any], adopting: bool = True) -> None:
        """Take settings, and wait until the tasks that are there are known."""
        self.detector.apply(read_detector_settings(document, "config.yaml"))
        if adopting:
            until(lambda: all(operator.adopted is not None for operator in self.operators))
            self.detector.turn()

    def send(self, agent: str, x: float, age_ms: int = 5) -> None:
        """A pose of an agent."""
        self.now += 10 * MS
        topic = f"/vehicles/{agent.replace('-', '_')}/pose"
        self.live.topics[topic].waiting.append((pose(self.now - age_ms * MS, x), self.now))
        self.detector.turn()

    def say(self, topic: str, *values: float) -> None:
        """Numbers on a topic."""
        for value in values:
            self.now += 1000
            self.live.topics[topic].waiting.append((b"\0\1\0\0" + struct.pack("<d", value), self.now))
        self.detector.turn()

    def pass_seconds(self, seconds: float) -> None:
        """The time goes on."""
        self.now += int(seconds * SECOND)
        self.detector.turn()

    def events(self) -> list[dict[str, Any]]:
        """As /events."""
        events: list[dict[str, Any]] = self.detector.events_document()["events"]
        return events

    def edges(self) -> list[tuple[str, bool]]:
        """Each edge, and whether its task has been dealt with."""
        return [(event["edge"], event["done"] is not None) for event in self.events()]

    def done(self) -> list[str]:
        """Edges whose reaction the API server has acknowledged."""
        until(lambda: all(done for _, done in self.edges()))
        return [edge for edge, _ in self.edges()]

    def close(self) -> None:
        """End all threads."""
        for operator in self.operators:
            operator.stop(5.0)


class MemoryRecordings:
    """Keeps what it is asked for."""

    ready = True
    failed = ""
    waiting = 0

    def __init__(self, plan: Any, buffers: Any) -> None:
        self.plan, self.buffers = plan, buffers
        self.offered: list[tuple[str, int]] = []
        self.triggers: list[str] = []
        self.ends: list[str] = []
        self.gaps: list[Any] = []

    def note_gap(self, gap: Any) -> None:
        self.gaps.append(gap)

    def offer(self, topic: str, type_name: str, sample: Any) -> None:
        self.offered.append((topic, sample.stamp))

    def trigger(self, edge: Any, now: int) -> None:
        self.triggers.append(edge.id)

    def end(self, edge: Any, now: int) -> None:
        self.ends.append(edge.id)

    def tick(self, now: int) -> None: ...

    def counts(self) -> Mapping[str, int]:
        return {"stored": len(self.offered)}

    def stop(self, seconds: float) -> bool:
        time.sleep(0)
        return True
