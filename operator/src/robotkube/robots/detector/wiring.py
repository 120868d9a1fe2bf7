"""The wiring of a detector's process: adapters behind the ports of its loops, imported when they are needed."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robotkube.errors import InputError
from robotkube.foundation.runtime.loops.fencing import Fencing
from robotkube.foundation.runtime.process import PodSettings, read_secret
from robotkube.robots.detector.core.settings import DetectorSettings, SettingsContext
from robotkube.robots.reactions.core.settings import (
    DeliveryReactionSettings,
    MqttReactionSettings,
    PythonReactionSettings,
    WebhookReactionSettings,
)
from robotkube.robots.reactions.loops.operator import OperatorReactions
from robotkube.robots.recording.core.plans import RecordingPlan

if TYPE_CHECKING:
    from robotkube.robots.detector.loops.broker import Broker
    from robotkube.robots.reactions.loops.dead_letters import DeadLetterBox
    from robotkube.robots.reactions.loops.delivery_journal import DeliveryJournal
    from robotkube.robots.reactions.ports.deliveries import DeliverySender, RunningReaction, Spans
    from robotkube.robots.recording.loops.recordings import Recordings
    from robotkube.robots.recording.ports import RecordingStore, WritableVolume
    from robotkube.robots.ros.core.cdr_readers.readers import Layouts
    from robotkube.robots.ros.core.gaps import Gap
    from robotkube.robots.ros.core.ring_buffers import RingBuffer
    from robotkube.robots.rules.core.specification.expressions import CheckExpressions
    from robotkube.robots.rules.loops.workers import RuleWorkers

RECORDINGS_FOLDER = "/var/lib/robotkube/recordings"
SESSION_SECONDS = 60
JOURNAL_VARIABLE = "ROBOTKUBE_REACTIONS"
SPANS_VARIABLE = "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT"


def make_operator(
    settings: DetectorSettings, pod: PodSettings, fencing: Fencing, box: DeadLetterBox
) -> OperatorReactions:
    """Start the operator reaction, whose tasks are in the namespace of the pod's ConfigMap."""
    from robotkube.foundation.kubernetes.adapters.http_client import ApiServer, split_name
    from robotkube.robots.detector.adapters.api_tasks import ApiTasks

    namespace, _ = split_name(pod.config_map or settings.name)
    tasks = ApiTasks(ApiServer.from_environment(os.environ), namespace, fencing)
    reactions = OperatorReactions(settings.name, namespace, tasks, time.time_ns, time.monotonic, settings.task, box)
    reactions.start()
    return reactions


def make_journal(folder: str, name: str, box: DeadLetterBox) -> DeliveryJournal:
    """Start the journal of a detector's deliveries; `name` is the detector's."""
    from robotkube.robots.reactions.adapters.delivery_files import DeliveryFile
    from robotkube.robots.reactions.loops.delivery_journal import DeliveryJournal

    place = DeliveryFile(Path(folder) / name.replace("/", "_"))
    journal = DeliveryJournal(place, box, time.time_ns, time.monotonic)
    journal.start()
    return journal


def make_reaction(
    settings: DeliveryReactionSettings,
    pod: PodSettings,
    fencing: Fencing,
    box: DeadLetterBox,
    broker: Callable[[], Broker],
    journal: DeliveryJournal | None,
) -> RunningReaction:
    """Start a reaction that delivers edges."""
    from robotkube.robots.reactions.loops.delivery_journal import ReactionJournal

    reaction_journal = ReactionJournal(journal, settings.key, settings.name)
    if isinstance(settings, MqttReactionSettings):
        from robotkube.robots.detector.loops.broker import MqttReactions

        return MqttReactions(settings, broker(), box, time.monotonic, reaction_journal)
    from robotkube.robots.reactions.loops.deliveries import Deliveries
    from robotkube.robots.reactions.loops.fenced_sender import FencedSender

    sender = FencedSender(_sender(settings, pod), fencing)
    deliveries = Deliveries(settings.name, sender, settings.retry_seconds, box, time.monotonic, reaction_journal)
    deliveries.start()
    return deliveries


def _sender(settings: WebhookReactionSettings | PythonReactionSettings, pod: PodSettings) -> DeliverySender:
    if isinstance(settings, PythonReactionSettings):
        from robotkube.robots.reactions.adapters.child_processes import ProcessSender

        return ProcessSender(settings.plugin, settings.settings, settings.timeout_seconds)
    from robotkube.robots.reactions.adapters.webhook_sender import WebhookSender

    folder = pod.broker_folder.parent / "webhooks"
    key = settings.secret
    secret = (lambda: read_secret(folder, key).encode()) if key else None
    return WebhookSender(settings.url, secret, settings.timeout_seconds)


def make_recordings(
    plan: RecordingPlan,
    buffers: Mapping[str, RingBuffer],
    pod: PodSettings,
    fencing: Fencing,
    carried: Callable[[str], str],
) -> Recordings:
    """Start the recordings of a recording reaction. `carried`: the definition of a type that the broker has carried,
    else empty."""
    from robotkube.robots.recording.loops.destinations import RecorderPlace
    from robotkube.robots.recording.loops.recordings import Recordings

    if not pod.node:
        raise InputError("NODE_NAME is not set; a recording's index names the node: set it from spec.nodeName")
    root = Path(os.environ.get("ROBOTKUBE_RECORDINGS", RECORDINGS_FOLDER))
    place = RecorderPlace(
        volume=f"{pod.node}/{plan.volume}",
        open_store=lambda: _open_store(pod),
        open_volume_claim=lambda: _open_volume_claim(root, plan.recording),
        clock_ns=time.time_ns,
        monotonic=time.monotonic,
        fencing=fencing,
    )
    recordings = Recordings(plan, place, buffers, carried=carried)
    recordings.start()
    return recordings


def _open_store(pod: PodSettings) -> RecordingStore:
    from robotkube.foundation.database.adapters.connection import connect, read_account
    from robotkube.robots.recording.adapters.mongodb import PymongoRecordingStore

    return PymongoRecordingStore(connect(read_account(pod.database_folder)))


def _open_volume_claim(root: Path, owner: str) -> WritableVolume:
    from robotkube.robots.recording.adapters.volume_claim import MountedVolumeClaim

    return MountedVolumeClaim(root, owner, time.time_ns)


def make_broker(
    pod: PodSettings,
    name: str,
    fencing: Fencing,
    learned: Callable[[str], None],
    note_gap: Callable[[Gap], None],
) -> Broker:
    """The detector's connection to the broker. Its name is that of its release, which no bridge has, and of the
    Node that the release names."""
    from robotkube.robots.detector.loops.broker import Broker
    from robotkube.robots.mqtt.adapters.broker_account import read_broker_account
    from robotkube.robots.mqtt.adapters.paho_channel import PahoChannel

    connection = "-".join([name.replace("/", "-"), *([pod.placed_node] if pod.placed_node else [])])
    return Broker(
        lambda events: PahoChannel(lambda: read_broker_account(pod.broker_folder), connection, SESSION_SECONDS, events),
        time.time_ns,
        time.monotonic,
        learned,
        note_gap,
        fencing,
    )


def make_workers(settings: Callable[[], DetectorSettings], lookup: Callable[[str], str]) -> RuleWorkers:
    """The processes of rules of kinds cel and python, which start when rules need them."""
    from robotkube.robots.rules.host import start_rule
    from robotkube.robots.rules.loops.workers import RuleWorkers

    return RuleWorkers(lambda rule: start_rule(rule, settings().types, lookup), time.monotonic)


def make_spans(environment: Mapping[str, str], name: str) -> Spans | None:
    """The sender of spans; None when the environment names no collector."""
    endpoint = environment.get(SPANS_VARIABLE)
    if not endpoint:
        return None
    from robotkube.robots.detector.adapters.otlp_spans import OtlpSpans

    return OtlpSpans(endpoint, "robotkube-event-detector", name)


def settings_context(
    document: Mapping[str, Any], layouts: Layouts, check: CheckExpressions, missing_type: Callable[[str], str]
) -> SettingsContext:
    """The facts that a document is checked against; only what it needs is imported."""
    kinds = {
        item.get("kind")
        for key in ("rules", "reactions")
        if isinstance(items := document.get(key), list)
        for item in items
        if isinstance(item, Mapping) and isinstance(item.get("kind"), str)
    }
    rules = reactions = None
    if "python" in kinds:
        from robotkube.robots.reactions.adapters.child_processes import installed_reactions
        from robotkube.robots.rules.adapters.child_processes import installed_rules

        rules = installed_rules()
        reactions = installed_reactions()
    return SettingsContext(layouts, rules, reactions, check if "cel" in kinds else None, missing_type)
