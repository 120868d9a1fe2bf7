"""What a detector's process is made of: adapters behind the ports of its services, imported when they are needed."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robotkube.domain.demands import renewal
from robotkube.domain.detector_settings import DetectorSettings, Knowledge
from robotkube.domain.errors import InputError, RefusalError
from robotkube.domain.reaction_settings import DeliveryReaction, MqttReaction, PythonReaction, WebhookReaction
from robotkube.domain.recording_plans import RecordingPlan
from robotkube.entrypoints.processes import PodSettings, read_secret
from robotkube.services.ownership import Ownership
from robotkube.services.reactions.operator import OperatorReactions

if TYPE_CHECKING:
    from robotkube.adapters.kubernetes_http import ApiServer
    from robotkube.domain.audits import Gap
    from robotkube.domain.buffers import RingBuffer
    from robotkube.domain.layouts import Layouts
    from robotkube.domain.rules.asking import Check, Checked
    from robotkube.ports.reactions import Reaction, Sender, Spans
    from robotkube.ports.recordings import Claim, RecordingStore
    from robotkube.services.detector.broker import Broker
    from robotkube.services.reactions.dead import DeadLetterBox
    from robotkube.services.reactions.keeping import DeliveryJournal
    from robotkube.services.recording.recordings import Recordings
    from robotkube.services.rule_workers import RuleWorkers

RECORDINGS_FOLDER = "/var/lib/robotkube/recordings"
TASKS = ("robotkube.io", "v1alpha1", "taskdescriptions")
SESSION_SECONDS = 60
JOURNAL_VARIABLE = "ROBOTKUBE_REACTIONS"
SPANS_VARIABLE = "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT"


class ApiTasks:
    """The TaskDescriptions of one namespace over the API server (port OwnTasks). Nothing is written while the process
    is not sure that its release is still its own: UnavailableError."""

    def __init__(self, api: ApiServer, namespace: str, ownership: Ownership) -> None:
        self._api, self._namespace, self._ownership = api, namespace, ownership

    def tasks(self) -> Sequence[Mapping[str, Any]]:
        """All of them."""
        found = self._api.get(self._path()) or {}
        return list(found.get("items", []))

    def create(self, task: Mapping[str, Any]) -> None:
        """Make the object; RefusalError carries the server's words."""
        self._ownership.check()
        try:
            self._api.create(self._path(), task)
        except InputError as error:
            raise RefusalError("Refused", str(error)) from error

    def renew(self, name: str, now: int) -> bool:
        """Patch the annotation."""
        self._ownership.check()
        try:
            return self._api.patch(self._path(name), renewal(now))
        except InputError as error:
            raise RefusalError("Refused", str(error)) from error

    def delete(self, name: str) -> None:
        """Delete the object."""
        self._ownership.check()
        try:
            self._api.delete(self._path(name))
        except InputError as error:
            raise RefusalError("Refused", str(error)) from error

    def _path(self, name: str = "") -> str:
        from robotkube.adapters.kubernetes_http import custom_path

        group, version, plural = TASKS
        return custom_path(group, version, self._namespace, plural, name)


def make_operator(
    settings: DetectorSettings, pod: PodSettings, ownership: Ownership, box: DeadLetterBox
) -> OperatorReactions:
    """The started operator reaction; its tasks are in the namespace of the pod's ConfigMap."""
    from robotkube.adapters.kubernetes_http import ApiServer, split_name

    namespace, _ = split_name(pod.config_map or settings.name)
    tasks = ApiTasks(ApiServer.from_environment(os.environ), namespace, ownership)
    reactions = OperatorReactions(settings.name, namespace, tasks, time.time_ns, time.monotonic, settings.task, box)
    reactions.start()
    return reactions


def make_journal(folder: str, name: str, box: DeadLetterBox) -> DeliveryJournal:
    """The started journal of what a detector's reactions have not delivered; `name` is the detector's."""
    from robotkube.adapters.delivery_files import DeliveryFile
    from robotkube.services.reactions.keeping import DeliveryJournal

    place = DeliveryFile(Path(folder) / name.replace("/", "_"))
    journal = DeliveryJournal(place, box, time.time_ns, time.monotonic)
    journal.start()
    return journal


def make_reaction(
    settings: DeliveryReaction,
    pod: PodSettings,
    ownership: Ownership,
    box: DeadLetterBox,
    broker: Callable[[], Broker],
    journal: DeliveryJournal | None,
) -> Reaction:
    """A started reaction that tells somebody."""
    from robotkube.services.reactions.keeping import Kept

    kept = Kept(journal, settings.key, settings.name)
    if isinstance(settings, MqttReaction):
        from robotkube.services.detector.broker import MqttReactions

        return MqttReactions(settings, broker(), box, time.monotonic, kept)
    from robotkube.services.reactions.deliveries import Deliveries
    from robotkube.services.reactions.owned import OwnedSender

    sender = OwnedSender(_sender(settings, pod), ownership)
    found = Deliveries(settings.name, sender, settings.retry_seconds, box, time.monotonic, kept)
    found.start()
    return found


def _sender(settings: WebhookReaction | PythonReaction, pod: PodSettings) -> Sender:
    if isinstance(settings, PythonReaction):
        from robotkube.adapters.reaction_processes import ProcessSender

        return ProcessSender(settings.plugin, settings.settings, settings.timeout_seconds)
    from robotkube.adapters.webhook_sender import WebhookSender

    folder, key = pod.broker_folder.parent / "webhooks", settings.secret
    secret = (lambda: read_secret(folder, key).encode()) if key else None
    return WebhookSender(settings.url, secret, settings.timeout_seconds)


def make_recordings(
    plan: RecordingPlan,
    buffers: Mapping[str, RingBuffer],
    pod: PodSettings,
    ownership: Ownership,
    carried: Callable[[str], str],
) -> Recordings:
    """The started recording reaction. `carried`: the definition of a type that the broker has brought, else empty."""
    from robotkube.services.recording.places import RecorderPlace
    from robotkube.services.recording.recordings import Recordings

    if not pod.node:
        raise InputError("NODE_NAME is not set; a recording's index names the node: set it from spec.nodeName")
    root = Path(os.environ.get("ROBOTKUBE_RECORDINGS", RECORDINGS_FOLDER))
    place = RecorderPlace(
        volume=f"{pod.node}/{plan.volume}",
        open_store=lambda: _open_store(pod),
        open_claim=lambda: _open_claim(root, plan.recording),
        clock_ns=time.time_ns,
        monotonic=time.monotonic,
        ownership=ownership,
    )
    recordings = Recordings(plan, place, buffers, carried=carried)
    recordings.start()
    return recordings


def _open_store(pod: PodSettings) -> RecordingStore:
    from robotkube.adapters.mongodb_pymongo import PymongoRecordingStore, connect, read_account

    return PymongoRecordingStore(connect(read_account(pod.database_folder)))


def _open_claim(root: Path, owner: str) -> Claim:
    from robotkube.entrypoints.claims import VolumeClaim

    return VolumeClaim(root, owner, time.time_ns)


def make_broker(
    pod: PodSettings,
    name: str,
    ownership: Ownership,
    learned: Callable[[str], None],
    lacking: Callable[[Gap], None],
) -> Broker:
    """The detector's connection to the broker; its name there is that of its release, which no bridge has, and of the
    Node that the release names."""
    from robotkube.adapters.mqtt_paho import BrokerAccount, PahoChannel
    from robotkube.services.detector.broker import Broker

    def account() -> BrokerAccount:
        folder = pod.broker_folder
        port = read_secret(folder, "port")
        if not port.isdecimal():
            raise InputError(f"{folder / 'port'}: {port!r} is no port number")
        words = [read_secret(folder, key) for key in ("host", "username", "password")]
        return BrokerAccount(words[0], int(port), words[1], words[2])

    client = "-".join([name.replace("/", "-"), *([pod.placed_node] if pod.placed_node else [])])
    return Broker(
        lambda events: PahoChannel(account, client, SESSION_SECONDS, events),
        time.time_ns,
        time.monotonic,
        learned,
        lacking,
        ownership,
    )


def make_workers(settings: Callable[[], DetectorSettings], lookup: Callable[[str], str]) -> RuleWorkers:
    """Processes for rules of kinds cel and python, started when rules ask for them."""
    from robotkube.entrypoints.rule_host import start_rule
    from robotkube.services.rule_workers import RuleWorkers

    return RuleWorkers(lambda rule: start_rule(rule, settings().types, lookup), time.monotonic)


def make_spans(environment: Mapping[str, str], name: str) -> Spans | None:
    """Where spans go when the environment names a collector."""
    endpoint = environment.get(SPANS_VARIABLE)
    if not endpoint:
        return None
    from robotkube.adapters.traces_otlp import OtlpSpans

    return OtlpSpans(endpoint, "robotkube-event-detector", name)


def installed_definition(type_name: str) -> str:
    """The definition of an installed type with all it uses; KeyError when it is not installed."""
    from robotkube.adapters.segments_mcap.definitions import definition

    found = definition(type_name, Path(sys.prefix) / "share")
    if not found:
        raise KeyError(type_name)
    return found


def definition(type_name: str, told: Mapping[str, str]) -> str:
    """The definition of a type: what is installed counts before what somebody at the broker `told`; KeyError when
    nobody knows it."""
    try:
        return installed_definition(type_name)
    except KeyError:
        return told[type_name]


def read_bag(
    path: Path, complain: Callable[[str], None], wanted: Callable[[str, str], bool]
) -> Iterator[tuple[str, str, int, bytes]]:
    """Topic, type, time in ns and bytes of a bag's messages; `wanted`: whether a topic of that type is read at all."""
    from robotkube.adapters.bags import open_bag

    with open_bag(path, complain) as bag:
        types = {topic.name: topic.type for topic in bag.topics}
        for topic, moment, data in bag.messages({name for name, kind in types.items() if wanted(name, kind)}):
            yield topic, types[topic], moment, data


class KnownExpressions:
    """What is wrong with expressions; asked only about those that are new, since the answer takes a second."""

    def __init__(self, check: Check) -> None:
        self._check = check
        self._known: dict[Checked, str] = {}

    def __call__(self, texts: Sequence[Checked]) -> Sequence[str]:
        """One text each, empty when it is well."""
        known = {text: self._known[text] for text in texts if text in self._known}
        new = [text for text in dict.fromkeys(texts) if text not in known]
        self._known = {**known, **(dict(zip(new, self._check(new), strict=True)) if new else {})}
        return [self._known[text] for text in texts]


def check_expressions(texts: Sequence[Checked]) -> Sequence[str]:
    """What is wrong with each of these expressions, by a process of its own."""
    from robotkube.entrypoints import rule_host

    return rule_host.check_expressions(texts)


def knowledge(document: Mapping[str, Any], layouts: Layouts, check: Check = check_expressions) -> Knowledge:
    """What a document is compared with; only what it needs is imported."""
    kinds = {
        item.get("kind")
        for key in ("rules", "reactions")
        if isinstance(items := document.get(key), list)
        for item in items
        if isinstance(item, Mapping) and isinstance(item.get("kind"), str)
    }
    rules = reactions = None
    if "python" in kinds:
        from robotkube.adapters.reaction_processes import installed_reactions
        from robotkube.adapters.rule_processes import installed_rules

        rules, reactions = installed_rules(), installed_reactions()
    return Knowledge(layouts, rules, reactions, check if "cel" in kinds else None)
