"""The MQTT task gateway of the manager: messages of operators become custom resources, and their statuses go back.

One thread receives a message, writes the object, then acknowledges the message: what was not written comes again, also
after a crash, and the same id twice is one task. So nothing is kept here that could be lost. While the API server is
away the message under way is tried again for at most TRY_SECONDS_MAX; the broker keeps the others.
"""

from __future__ import annotations

import logging
import random
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.backoffs import Random, backoff
from robotkube.delivery.tasks.core.holds import HOLDS_TOPIC
from robotkube.delivery.tasks.core.mqtt_messages import (
    GATEWAY,
    GATEWAY_LABEL,
    GATEWAY_REASONS,
    LEASE_ANNOTATION,
    NOT_ACCEPTED,
    NOT_REACHED,
    TASKS_TOPIC,
    UNKNOWN_TASK,
    LeaseRenewal,
    RejectedMessage,
    TaskRequest,
    TaskWithdrawal,
    changed_spec,
    gone_answer,
    operator_of,
    read_message,
    refusal_answer,
    status_answer,
    status_topic,
    task_document,
)
from robotkube.delivery.tasks.ports.mqtt_gateway import GatewayChannel, GatewayMessage, TaskWriter
from robotkube.delivery.tasks.ports.store import TaskStore
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.times import time_text
from robotkube.foundation.kubernetes.core.objects import object_key
from robotkube.foundation.kubernetes.ports import Leadership
from robotkube.foundation.runtime.ports import Series, by_one
from robotkube.robots.bridge.core.link_reports import LINKS_TOPIC, report_release

RECEIVE_SECONDS = 0.2
STATUS_SECONDS = 0.25
RETRY_SECONDS_FIRST = 0.2
RETRY_SECONDS_MAX = 5.0
TRY_SECONDS_MAX = 3600.0
LOGGED_CHARACTERS_MAX = 200
WRITES_MAX = 5  # attempts at a task that comes and goes between two calls

log = logging.getLogger(__name__)


@dataclass
class GatewayStatistics:
    """Counters since the start: messages by what came of them, and answers."""

    outcomes: dict[str, int] = field(
        default_factory=lambda: dict.fromkeys(("created", "changed", "withdrawn", "renewed", *GATEWAY_REASONS), 0)
    )
    answers: int = 0


class MqttTaskGateway:
    """The gateway for `operators` (name -> namespace of its tasks). `now_ns`: wall clock in ns since 1970; `monotonic`:
    a clock in seconds that never goes back; `holds` gets agent, payload and size of messages in which devices hold
    changes, `links` release, payload and size of those in which bridges say what they do not carry."""

    def __init__(
        self,
        operators: Mapping[str, str],
        channel: GatewayChannel,
        store: TaskStore,
        writer: TaskWriter,
        leadership: Leadership,
        now_ns: Callable[[], int],
        monotonic: Callable[[], float],
        holds: Callable[[str, bytes, int], None] = lambda agent, payload, size: None,
        links: Callable[[str, bytes, int], None] = lambda release, payload, size: None,
        jitter: Random = random.random,
    ) -> None:
        self._operators = dict(operators)
        self._channel = channel
        self._store = store
        self._writer = writer
        self._leadership = leadership
        self._now_ns = now_ns
        self._monotonic = monotonic
        self._holds = holds
        self._links = links
        self._jitter = jitter
        self._open = False
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="task-gateway", daemon=True)
        self._answered: dict[str, bytes] = {}
        self._answered_at = float("-inf")
        self.statistics = GatewayStatistics()

    @property
    def complaint(self) -> str:
        """The reason why operators are not heard; empty while the gateway is open, or another process of this manager
        has it open."""
        return self._channel.complaint if self._open else ""

    @property
    def is_open(self) -> bool:
        """Return whether operators are heard now."""
        return self._open and not self._channel.complaint

    def start(self) -> None:
        """Begin on a thread of its own: the gateway is open whenever this process leads."""
        self._thread.start()

    def stop(self, seconds: float) -> None:
        """Close it within `seconds`; a message under way comes again later."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(seconds)
        self._set_open(False)

    def _run(self) -> None:
        while not self._stopping.is_set():
            self.turn(RECEIVE_SECONDS)
            if not self._open:
                self._stopping.wait(RECEIVE_SECONDS)

    def _set_open(self, wanted: bool) -> None:
        if wanted and not self._open:
            names = sorted(self._operators)
            topics = [prefix + name for prefix in (TASKS_TOPIC, HOLDS_TOPIC) for name in names]
            self._channel.start([*topics, *(f"{LINKS_TOPIC}{name}/+" for name in names)])
        elif self._open and not wanted:
            self._channel.close()
            self._answered.clear()
        self._open = wanted

    def turn(self, seconds: float) -> None:
        """Handle the next message, if one comes within `seconds`; then answer operators what changed. Only one process
        of a manager has the session at the broker: the one that leads."""
        self._set_open(self._leadership.term() is not None)
        if not self._open:
            return
        message = self._channel.receive(seconds)
        if message is not None:
            self._handle(message)
        if self._monotonic() - self._answered_at >= STATUS_SECONDS:
            self._answered_at = self._monotonic()
            self._publish_changes()

    # -- orders ---------------------------------------------------------------------------------------------------

    def _handle(self, message: GatewayMessage) -> None:
        if message.topic.startswith(LINKS_TOPIC):
            if release := report_release(self._operators, message.topic):
                self._links(release, message.payload, message.size)
            self._channel.acknowledge(message)
            return
        agent = message.topic.removeprefix(HOLDS_TOPIC)
        if agent != message.topic:
            if agent in self._operators:
                self._holds(agent, message.payload, message.size)
            self._channel.acknowledge(message)
            return
        operator = operator_of(message.topic)
        if operator not in self._operators:
            self._channel.acknowledge(message)  # of a session older than our settings
            return
        order = read_message(message.payload, message.size)
        outcome = order if isinstance(order, RejectedMessage) else self._persist(operator, order)
        if outcome is None:
            return  # the process ends: it comes again
        if isinstance(outcome, RejectedMessage):
            if not self._channel.publish(status_topic(operator), refusal_answer(outcome)):
                self._channel.leave(message)
                return
            self._record_refusal(operator, outcome)
        else:
            log.info("order carried out operator=%s task=%s outcome=%s", operator, getattr(order, "id", ""), outcome)
            self._count(outcome)
        self._channel.acknowledge(message)

    def _record_refusal(self, operator: str, refused: RejectedMessage) -> None:
        text = refused.message[:LOGGED_CHARACTERS_MAX]
        log.warning("order refused operator=%s task=%s cause=%s reason=%s", operator, refused.id, refused.reason, text)
        self._count(refused.reason)

    def _count(self, outcome: str) -> None:
        self.statistics.outcomes[outcome] += 1

    def _persist(
        self, operator: str, order: TaskRequest | TaskWithdrawal | LeaseRenewal
    ) -> str | RejectedMessage | None:
        """Carry the order out, trying again while the API server is away; None when the process ends before."""
        began = self._monotonic()
        attempts = 0
        while not self._stopping.is_set():
            try:
                return self._carry_out(operator, self._operators[operator], order)
            except InputError as error:
                return RejectedMessage(NOT_ACCEPTED, str(error), order.id)
            except UnavailableError as error:
                if self._monotonic() - began > TRY_SECONDS_MAX:
                    return RejectedMessage(NOT_REACHED, f"{error}; given up after {TRY_SECONDS_MAX:.0f} s", order.id)
                pause = backoff(attempts, RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX, self._jitter)
                log.warning("order waits task=%s seconds=%.1f reason=%s", order.id, pause, error)
                self._stopping.wait(pause)
                attempts += 1
        return None

    def _carry_out(
        self, operator: str, namespace: str, order: TaskRequest | TaskWithdrawal | LeaseRenewal
    ) -> str | RejectedMessage:
        if isinstance(order, TaskRequest):
            return self._create_or_change(operator, namespace, order)
        if isinstance(order, TaskWithdrawal):
            if self._writer.delete(namespace, order.id):
                return "withdrawn"
        elif self._writer.annotate(namespace, order.id, {LEASE_ANNOTATION: self._now()}):
            return "renewed"
        return RejectedMessage(UNKNOWN_TASK, f"there is no task {namespace}/{order.id}", order.id)

    def _create_or_change(self, operator: str, namespace: str, order: TaskRequest) -> str:
        for _ in range(WRITES_MAX):
            if self._writer.create(task_document(operator, namespace, order, self._now())):
                return "created"
            present = self._writer.find(namespace, order.id)
            if present is None:
                continue
            spec = changed_spec(present, operator, order, self._now())
            if self._writer.patch_spec(namespace, order.id, spec):
                return "changed"
        raise UnavailableError(f"task {namespace}/{order.id} comes and goes")

    def _now(self) -> str:
        return time_text(self._now_ns())

    # -- answers --------------------------------------------------------------------------------------------------

    def _publish_changes(self) -> None:
        """Publish the answers that differ from those sent before; what the broker did not accept is published the next
        time."""
        owners = {namespace: operator for operator, namespace in self._operators.items()}
        answers = {object_key(task): status_answer(task) for task in self._store.tasks() if _is_ours(task, owners)}
        for key in sorted({*self._answered, *answers}):
            namespace, _, name = key.partition("/")
            answer = answers.get(key) or gone_answer(name)
            if self._answered.get(key) == answer:
                continue
            if not self._channel.publish(status_topic(owners[namespace]), answer):
                return
            self.statistics.answers += 1
            if key in answers:
                self._answered[key] = answer
            else:
                self._answered.pop(key)


def _is_ours(task: Mapping[str, Any], owners: Mapping[str, str]) -> bool:
    """Return whether the task was asked for through this gateway."""
    metadata = task["metadata"]
    return metadata.get("namespace") in owners and metadata.get("labels", {}).get(GATEWAY_LABEL) == GATEWAY


def gateway_metrics(gateway: MqttTaskGateway) -> Sequence[Series]:
    """The gateway's counters as metrics."""
    prefix = "robotkube_task_gateway_"
    statistics = gateway.statistics
    return (
        Series(
            f"{prefix}messages_total",
            "counter",
            "Messages by what came of them.",
            by_one(statistics.outcomes),
            ("outcome",),
        ),
        Series(f"{prefix}answers_total", "counter", "Answers that were given.", {(): statistics.answers}),
        Series(f"{prefix}connected", "gauge", "1 while the gateway is open, else 0.", {(): int(gateway.is_open)}),
    )
