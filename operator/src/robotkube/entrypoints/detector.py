"""The event detector's process: operator and recording use alike, as its settings say.

    python3 -m robotkube.entrypoints.detector

Inputs (docs/reference/event-detector.md): `config.yaml`, watched through the API when ROBOTKUBE_CONFIGMAP names it; for
recordings NODE_NAME, the mounted Secret `database` and the claim at ROBOTKUBE_RECORDINGS; for MQTT the mounted Secret
`broker`, for signed webhooks `webhooks`. Port 8081: health, /metrics, /status, /input, /events, and POST /state.

The order of the start is chosen for the time from an event to the first stored message: subscriptions first, then what
imports and connects (database, segments, API server), each on a thread of its own.
"""

from __future__ import annotations

import gc
import json
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robotkube.adapters.health_http import HealthServer
from robotkube.adapters.ros_rclpy import RosNode
from robotkube.domain.detector_settings import MQTT, STATES, DetectorSettings, read_detector_settings
from robotkube.domain.errors import InputError, RobotKubeError
from robotkube.domain.layouts import Layouts
from robotkube.domain.texts import read_mapping
from robotkube.entrypoints import detector_parts as parts
from robotkube.entrypoints.following import follow_settings, ownership_of
from robotkube.entrypoints.processes import PodSettings, Process, read_text, run
from robotkube.entrypoints.ros_topics import RosTopics
from robotkube.services.detector.detector import EventDetector
from robotkube.services.detector.raising import Raising
from robotkube.services.detector.recording import RecordingReactions
from robotkube.services.detector.status import Refusal, Status
from robotkube.services.reactions.keeping import MEMORY_ONLY

if TYPE_CHECKING:
    from robotkube.adapters.kubernetes_http import ConfigMapWatch
    from robotkube.ports.robots import LiveTopics
    from robotkube.services.detector.broker import Broker
    from robotkube.services.reactions.dead import DeadLetterBox
    from robotkube.services.reactions.keeping import DeliveryJournal

BUSY_SECONDS, IDLE_SECONDS = 0.016, 0.02
"""From one look at the subscriptions to the next, while messages come and when none has come for IDLE_AFTER_SECONDS."""
IDLE_AFTER_SECONDS = 1.0
LAST_DRAIN_SECONDS_MAX = 0.5
STORE_SECONDS_MAX = 5.0
DELIVER_SECONDS_MAX = 1.0
KEEP_SECONDS_MAX = 0.5
LEAVE_SECONDS_MAX = 1.0
GRACE_SECONDS = 9.0
NEWS_MAX, COMMANDS_MAX = 16, 16
CONFIG_KEY = "config.yaml"


def main() -> None:
    """Run until SIGTERM; exit codes as in `processes`."""
    run("event-detector", body, GRACE_SECONDS)


def body(process: Process) -> None:
    """Start, receive until the process shall end, then store and deliver what was received."""
    _log_through(process)
    pod = PodSettings.from_environment()
    room = Room(process, pod)
    settings = room.read(read_text(pod.config_file, "the detector's settings"), str(pod.config_file))
    room.begin(settings)
    process.log(
        "subscribed", name=settings.name, subscriptions=room.detector.subscribed, seconds=_process_age_seconds()
    )
    server = room.serve()
    watch = room.watch()
    room.receive()
    if watch is not None:
        watch.stop()
    room.end()
    server.close()


class Room:
    """The detector with everything around it. `receive` runs on the main thread; pages and the watch have their own."""

    def __init__(self, process: Process, pod: PodSettings) -> None:
        self._process, self._pod = process, pod
        self._ownership = ownership_of(pod)
        self._node = RosNode("event_detector")
        self._ros = RosTopics(self._node)
        self._broker: Broker | None = None
        self._journal: DeliveryJournal | None = None
        self._name = pod.config_map or ""
        self._news: deque[tuple[DetectorSettings, int]] = deque(maxlen=NEWS_MAX)
        self._commands: deque[tuple[str, int]] = deque(maxlen=COMMANDS_MAX)
        self._expressions = parts.KnownExpressions(parts.check_expressions)
        self._learned: deque[str] = deque()
        self._ready = False
        self.refusal = Refusal()
        self._spans = parts.make_spans(os.environ, self._name)
        self.layouts = Layouts(self._definition)
        self.detector = self._make()
        self.status = Status(self.detector, time.time_ns, self.refusal, self._unreachable, self._kept)

    def _make(self) -> EventDetector:
        raising = Raising(
            lambda settings, box: parts.make_operator(settings, self._pod, self._ownership, box),
            lambda settings, box: parts.make_reaction(
                settings, self._pod, self._ownership, box, self._connection, self._journal_of(box)
            ),
            time.time_ns,
            self._spans,
        )
        recordings = RecordingReactions(
            lambda plan, buffers: parts.make_recordings(plan, buffers, self._pod, self._ownership, self._carried)
        )
        return EventDetector(
            self._source,
            self.layouts,
            raising,
            recordings,
            lambda: parts.make_workers(lambda: self.detector.settings, self._definition),
            time.time_ns,
            time.monotonic,
        )

    def read(self, text: str, where: str) -> DetectorSettings:
        """Settings from a text; DocumentError with all problems."""
        document = read_mapping(text, where, values=False)
        return read_detector_settings(document, where, parts.knowledge(document, self.layouts, self._expressions))

    def begin(self, settings: DetectorSettings) -> None:
        """Apply the first settings, and fill the buffers when they name a bag."""
        self._name = settings.name
        self.detector.apply(settings)
        if settings.bag:
            try:
                filled = self.detector.fill(
                    parts.read_bag(Path(settings.bag), self._complain, self.detector.topics.asked)
                )
            except InputError as error:
                raise InputError(f"{self._pod.config_file}: buffer.bag: {error}") from error
            self._process.log("filled", bag=settings.bag, messages=filled)

    def _complain(self, sentence: str) -> None:
        self._process.log("bag", problem=sentence)

    def serve(self) -> HealthServer:
        """The started health port."""
        status, detector = self.status, self.detector
        server = HealthServer(
            live=lambda: next((one.failed for one in detector.recordings.at_work if one.failed), None),
            ready=lambda: status.not_ready() or None,
            metrics=lambda: status.metrics() + self._ownership.metrics(),
            pages={
                "/input": lambda: json.dumps(detector.input_document()),
                "/events": lambda: json.dumps(detector.events_document()),
                "/status": lambda: json.dumps(status.document()),
            },
            port=self._pod.health_port,
            commands={"/state": self._command},
        )
        server.start()
        return server

    def watch(self) -> ConfigMapWatch | None:
        """Follow the ConfigMap; settings are read on the watch's thread, which may take its time."""
        if self._pod.config_map is None:
            return None

        def take(data: Mapping[str, str]) -> None:
            if CONFIG_KEY in data:
                self._change(data[CONFIG_KEY])

        return follow_settings(self._process, self._pod.config_map, self._ownership, take)

    def receive(self) -> None:
        """Turn until the process shall end."""
        heard = time.monotonic()
        pause = BUSY_SECONDS
        while not self._process.stopping.is_set():
            # not an event that ends the pause: it costs a tenth of all that receiving 1,500 poses/s does
            time.sleep(pause)
            self._obey()
            now = time.monotonic()
            heard = now if self._turn() else heard
            pause = BUSY_SECONDS if now - heard < IDLE_AFTER_SECONDS else IDLE_SECONDS
            if not self._ready and not self.status.not_ready():
                self._ready = True
                gc.freeze()  # what the start has made stays: the collector shall not go through it again and again
                self._process.log("ready", seconds=_process_age_seconds())

    def end(self) -> None:
        """Go on for as long as the recordings ask for, take what has arrived already, then store and deliver it."""
        finish(self._turn, self.detector.recordings.after_seconds)
        if self._journal is not None:
            self._journal.end()
        stopping = [
            _beside(partial(self.detector.raising.stop, DELIVER_SECONDS_MAX)),
            *(_beside(partial(one.stop, STORE_SECONDS_MAX)) for one in self.detector.recordings.at_work),
        ]
        complete = [stopped() for stopped in stopping]
        if self._broker is not None:
            complete.append(self._broker.close(DELIVER_SECONDS_MAX, time.sleep))
        if self._journal is not None:
            complete.append(self._journal.stop(KEEP_SECONDS_MAX))
        self.detector.stop()
        if self._spans is not None:
            self._spans.close()
        recordings = len(self.detector.recordings.at_work)
        self._process.log("stopped", recordings=recordings, complete=all(complete))
        _leave(self._node)

    # on the main thread ----------------------------------------------------------------------------------------------

    def _turn(self) -> int:
        if self._broker is not None:
            self._broker.turn()
            while self._learned:
                self.detector.learn(self._learned.popleft())
        return self.detector.turn()

    def _obey(self) -> None:
        while self._news:
            self.detector.apply(*self._news.popleft())
            for recordings in self.detector.recordings.leaving():
                _beside(partial(recordings.stop, STORE_SECONDS_MAX))
            for reaction in self.detector.raising.leaving():
                _beside(partial(reaction.stop, DELIVER_SECONDS_MAX))
        while self._commands:
            self.detector.change_state(*self._commands.popleft())

    def _journal_of(self, box: DeadLetterBox) -> DeliveryJournal | None:
        """What keeps deliveries on the disk, made for the first reaction that tells somebody."""
        folder = os.environ.get(parts.JOURNAL_VARIABLE, "")
        if self._journal is None and folder:
            self._journal = parts.make_journal(folder, self._name, box)
        return self._journal

    def _source(self, name: str) -> LiveTopics:
        return self._connection() if name == MQTT else self._ros

    def _connection(self) -> Broker:
        if self._broker is None:
            lack = self.detector.recordings.lack
            self._broker = parts.make_broker(self._pod, self._name, self._ownership, self._learned.append, lack)
        return self._broker

    # on other threads ------------------------------------------------------------------------------------------------

    def _change(self, text: str) -> None:
        """Settings that were refused are reported, and the present ones stay."""
        asked = time.time_ns()
        try:
            settings = self.read(text, CONFIG_KEY)
        except InputError as error:
            self.refusal.error, self.refusal.time = str(error), time.time_ns()
            self.refusal.count += 1
            self._process.log("settings refused", error=str(error))
            self._warn(str(error))
            return
        self.refusal.error = ""
        self._news.append((settings, asked))

    def _warn(self, sentence: str) -> None:
        """A Kubernetes Event about the ConfigMap, where its author looks."""
        from robotkube.adapters.kubernetes_http import ApiServer, config_map_warning, event_path, split_name
        from robotkube.domain.demands import time_text

        namespace, name = split_name(self._pod.config_map or "")
        message = f"{sentence}; the settings before go on"
        component, now = "event-detector", time_text(time.time_ns())
        event = config_map_warning(namespace, name, "SettingsRefused", message, component, now)
        try:
            ApiServer.from_environment(os.environ).create(event_path(namespace), event)
        except RobotKubeError as error:
            self._process.log("no Kubernetes Event", error=str(error))

    def _command(self, sent: bytes) -> tuple[int, str]:
        """POST /state with `{"state": "active"}`."""
        try:
            state = json.loads(sent)["state"]
        except (ValueError, KeyError, TypeError, RecursionError):
            state = None
        if state not in STATES:
            return 400, json.dumps({"error": f'send {{"state": ...}} with one of {", ".join(STATES)}'})
        self._commands.append((state, time.time_ns()))
        return 202, json.dumps({"state": state})

    def _carried(self, type_name: str) -> str:
        return "" if self._broker is None else self._broker.definitions.get(type_name, "")

    def _definition(self, type_name: str) -> str:
        return parts.definition(type_name, {} if self._broker is None else self._broker.definitions)

    def _kept(self) -> Mapping[str, Any]:
        return MEMORY_ONLY if self._journal is None else self._journal.document()

    def _unreachable(self) -> str:
        return "" if self._broker is None else self._broker.unreachable


def finish(turn: Callable[[], int], seconds: float) -> None:
    """Receive for so long, then what has arrived already."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        time.sleep(BUSY_SECONDS)
        turn()
    deadline = time.monotonic() + LAST_DRAIN_SECONDS_MAX
    while turn() and time.monotonic() < deadline:
        time.sleep(BUSY_SECONDS)


def _beside(work: Callable[[], bool]) -> Callable[[], bool]:
    """Do it on a thread of its own; who calls what this gives waits for the answer."""
    answers: list[bool] = []
    thread = threading.Thread(target=lambda: answers.append(work()), name="stop", daemon=True)
    thread.start()

    def answer() -> bool:
        thread.join(STORE_SECONDS_MAX + 1)
        return bool(answers and answers[0])

    return answer


def _leave(node: RosNode) -> None:
    """Say goodbye to the publishers, or they wait 20 s for a reader that is gone. The middleware may hang here."""
    thread = threading.Thread(target=node.close, name="leave", daemon=True)
    thread.start()
    thread.join(LEAVE_SECONDS_MAX)


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
