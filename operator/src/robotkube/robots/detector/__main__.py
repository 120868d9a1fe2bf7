"""The event detector's process: operator and recording use alike, as its settings say.

    python3 -m robotkube.robots.detector

Inputs (docs/reference/event-detector.md): `config.yaml`, watched through the API when ROBOTKUBE_CONFIGMAP names it; for
recordings NODE_NAME, the mounted Secret `database` and the volume at ROBOTKUBE_RECORDINGS; for MQTT the mounted Secret
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

from robotkube.errors import InputError, RobotKubeError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.foundation.runtime.adapters.health_server import HealthServer
from robotkube.foundation.runtime.config_watch import fencing_of, watch_settings
from robotkube.foundation.runtime.loops.settings_report import SettingsReport
from robotkube.foundation.runtime.process import PodSettings, Process, read_text, run
from robotkube.robots.detector import wiring
from robotkube.robots.detector.adapters.expression_checks import CachedExpressionCheck
from robotkube.robots.detector.adapters.ros_topics import RosTopics
from robotkube.robots.detector.adapters.type_definitions import definition
from robotkube.robots.detector.core.settings import MQTT, STATES, DetectorSettings, read_detector_settings
from robotkube.robots.detector.loops.detector import EventDetector
from robotkube.robots.detector.loops.dispatching import Dispatcher
from robotkube.robots.detector.loops.recording import RecordingReactions
from robotkube.robots.detector.loops.status import DetectorStatus, SettingsRefusal
from robotkube.robots.reactions.loops.delivery_journal import MEMORY_ONLY
from robotkube.robots.ros.adapters.rclpy_node import RosNode, missing_type
from robotkube.robots.ros.core.cdr_readers.readers import Layouts

if TYPE_CHECKING:
    from robotkube.foundation.kubernetes.adapters.http_client import ConfigMapWatch
    from robotkube.robots.detector.loops.broker import Broker
    from robotkube.robots.detector.ports import LiveTopics
    from robotkube.robots.reactions.loops.dead_letters import DeadLetterBox
    from robotkube.robots.reactions.loops.delivery_journal import DeliveryJournal

BUSY_SECONDS, IDLE_SECONDS = 0.016, 0.02
"""The poll intervals of subscriptions, while messages come and when none has come for IDLE_AFTER_SECONDS."""
IDLE_AFTER_SECONDS = 1.0
LAST_DRAIN_SECONDS_MAX = 0.5
STORE_SECONDS_MAX = 5.0
DELIVER_SECONDS_MAX = 1.0
JOURNAL_SECONDS_MAX = 0.5
LEAVE_SECONDS_MAX = 1.0
GRACE_SECONDS = 9.0
SETTINGS_QUEUED_MAX = 16
COMMANDS_MAX = 16
CONFIG_KEY = "config.yaml"


def main() -> None:
    """Run until SIGTERM; exit codes as in `foundation.runtime.process`."""
    run("event-detector", body, GRACE_SECONDS)


def body(process: Process) -> None:
    """Start the detector, receive until the process shall end, then store and deliver what was received."""
    _log_through(process)
    pod = PodSettings.from_environment()
    detector = DetectorProcess(process, pod)
    settings = detector.read(read_text(pod.config_file, "the detector's settings"), str(pod.config_file))
    detector.begin(settings)
    process.log(
        "subscribed", name=settings.name, subscriptions=detector.detector.subscribed, seconds=_process_age_seconds()
    )
    server = detector.serve()
    watch = detector.watch()
    detector.receive()
    if watch is not None:
        watch.stop()
    detector.end()
    server.close()


class DetectorProcess:
    """The detector in its process, with connections, pages and the watch of its settings. `receive` runs on the main
    thread, the others have theirs."""

    def __init__(self, process: Process, pod: PodSettings) -> None:
        self._process = process
        self._pod = pod
        self._fencing = fencing_of(pod)
        self._node = RosNode("event_detector")
        self._ros = RosTopics(self._node)
        self._broker: Broker | None = None
        self._journal: DeliveryJournal | None = None
        self._name = pod.config_map or ""
        self._new_settings: deque[tuple[DetectorSettings, int, str]] = deque(maxlen=SETTINGS_QUEUED_MAX)
        self._commands: deque[tuple[str, int]] = deque(maxlen=COMMANDS_MAX)
        self._expressions = CachedExpressionCheck()
        self._learned_types: deque[str] = deque()
        self._ready = False
        self.refusal = SettingsRefusal()
        self._report = SettingsReport()
        self._spans = wiring.make_spans(os.environ, self._name)
        self.layouts = Layouts(self._definition)
        self.detector = self._make()
        self.status = DetectorStatus(
            self.detector, time.time_ns, self.refusal, self._unreachable, self._journal_document, self._report
        )

    def _make(self) -> EventDetector:
        dispatcher = Dispatcher(
            lambda settings, box: wiring.make_operator(settings, self._pod, self._fencing, box),
            lambda settings, box: wiring.make_reaction(
                settings, self._pod, self._fencing, box, self._connection, self._journal_of(box)
            ),
            time.time_ns,
            self._spans,
        )
        recordings = RecordingReactions(
            lambda plan, buffers: wiring.make_recordings(plan, buffers, self._pod, self._fencing, self._carried)
        )
        return EventDetector(
            self._source,
            self.layouts,
            dispatcher,
            recordings,
            lambda: wiring.make_workers(lambda: self.detector.settings, self._definition),
            time.time_ns,
            time.monotonic,
        )

    def read(self, text: str, where: str) -> DetectorSettings:
        """Read settings from a text; DocumentError has all problems."""
        document = read_mapping(text, where, values=False)
        context = wiring.settings_context(document, self.layouts, self._expressions, missing_type)
        return read_detector_settings(document, where, context)

    def begin(self, settings: DetectorSettings) -> None:
        """Apply the first settings, and fill the buffers when they name a bag."""
        self._name = settings.name
        self.detector.apply(settings)
        if settings.bag:
            from robotkube.robots.detector.adapters.bag_messages import read_bag

            try:
                messages = read_bag(Path(settings.bag), self._log_bag_problem, self.detector.topics.is_configured)
                filled = self.detector.fill(messages)
            except InputError as error:
                raise InputError(f"{self._pod.config_file}: buffer.bag: {error}") from error
            self._process.log("filled", bag=settings.bag, messages=filled)

    def _log_bag_problem(self, sentence: str) -> None:
        self._process.log("bag", problem=sentence)

    def serve(self) -> HealthServer:
        """Start the server of health and pages."""
        status = self.status
        detector = self.detector
        server = HealthServer(
            live=lambda: next(
                (recordings.failed for recordings in detector.recordings.at_work if recordings.failed), None
            ),
            ready=lambda: status.not_ready() or None,
            metrics=lambda: status.metrics() + self._fencing.metrics(),
            pages={
                "/input": lambda: json.dumps(detector.input_document()),
                "/events": lambda: json.dumps(detector.events_document()),
                "/recordings": lambda: json.dumps(detector.recordings.document()),
                "/status": lambda: json.dumps(status.document()),
            },
            port=self._pod.health_port,
            commands={"/state": self._command},
        )
        server.start()
        return server

    def watch(self) -> ConfigMapWatch | None:
        """Start the watch of the ConfigMap, whose thread reads settings; None when there is no ConfigMap."""
        if self._pod.config_map is None:
            return None

        def receive(data: Mapping[str, str]) -> None:
            if CONFIG_KEY in data:
                self._change(data[CONFIG_KEY])

        return watch_settings(self._process, self._pod.config_map, self._fencing, receive)

    def receive(self) -> None:
        """Run the detector's turns until the process shall end."""
        last_message_at = time.monotonic()
        pause = BUSY_SECONDS
        while not self._process.stopping.is_set():
            # not an event that ends the pause: it costs a tenth of all that receiving 1,500 poses/s does
            time.sleep(pause)
            self._apply_queued()
            now = time.monotonic()
            last_message_at = now if self._turn() else last_message_at
            pause = BUSY_SECONDS if now - last_message_at < IDLE_AFTER_SECONDS else IDLE_SECONDS
            if not self._ready and not self.status.not_ready():
                self._ready = True
                gc.freeze()  # what the start has made stays: the collector shall not go through it again and again
                self._process.log("ready", seconds=_process_age_seconds())

    def end(self) -> None:
        """Receive for as long as the recordings ask for and what has arrived already, then store and deliver it."""
        finish(self._turn, self.detector.recordings.after_seconds)
        if self._journal is not None:
            self._journal.end()
        stopping = [
            _on_thread(partial(self.detector.dispatcher.stop, DELIVER_SECONDS_MAX)),
        ]
        for recordings in self.detector.recordings.at_work:
            stopping.append(_on_thread(partial(recordings.stop, STORE_SECONDS_MAX)))
        complete = [stopped() for stopped in stopping]
        if self._broker is not None:
            complete.append(self._broker.close(DELIVER_SECONDS_MAX, time.sleep))
        if self._journal is not None:
            complete.append(self._journal.stop(JOURNAL_SECONDS_MAX))
        self.detector.stop()
        if self._spans is not None:
            self._spans.close()
        self._process.log("stopped", recordings=len(self.detector.recordings.at_work), complete=all(complete))
        _leave(self._node)

    # on the main thread ----------------------------------------------------------------------------------------------

    def _turn(self) -> int:
        if self._broker is not None:
            self._broker.turn()
            while self._learned_types:
                self.detector.learn(self._learned_types.popleft())
        return self.detector.turn()

    def _apply_queued(self) -> None:
        while self._new_settings:
            settings, asked_at, text = self._new_settings.popleft()
            self.detector.apply(settings, asked_at)
            self._report.taken(text)
            for recordings in self.detector.recordings.leaving():
                _on_thread(partial(recordings.stop, STORE_SECONDS_MAX))
            for reaction in self.detector.dispatcher.leaving():
                _on_thread(partial(reaction.stop, DELIVER_SECONDS_MAX))
        while self._commands:
            self.detector.change_state(*self._commands.popleft())

    def _journal_of(self, box: DeadLetterBox) -> DeliveryJournal | None:
        """The journal of deliveries, made for the first reaction that needs it; None when no folder is named."""
        folder = os.environ.get(wiring.JOURNAL_VARIABLE, "")
        if self._journal is None and folder:
            self._journal = wiring.make_journal(folder, self._name, box)
        return self._journal

    def _source(self, name: str) -> LiveTopics:
        return self._connection() if name == MQTT else self._ros

    def _connection(self) -> Broker:
        if self._broker is None:
            note_gap = self.detector.recordings.note_gap
            self._broker = wiring.make_broker(
                self._pod, self._name, self._fencing, self._learned_types.append, note_gap
            )
        return self._broker

    # on other threads ------------------------------------------------------------------------------------------------

    def _change(self, text: str) -> None:
        """Queue new settings; refused ones are reported, and the present ones stay."""
        asked_at = time.time_ns()
        self._report.given(text)
        try:
            settings = self.read(text, CONFIG_KEY)
        except InputError as error:
            self.refusal.error = str(error)
            self.refusal.time = time.time_ns()
            self.refusal.count += 1
            self._report.refused(text, str(error))
            self._process.log("settings refused", error=str(error))
            self._warn(str(error))
            return
        self.refusal.error = ""
        self._new_settings.append((settings, asked_at, text))

    def _warn(self, sentence: str) -> None:
        """Create a Kubernetes Event about the ConfigMap, where its author sees it."""
        from robotkube.robots.detector.adapters.config_map_events import report_refused_settings

        try:
            report_refused_settings(self._pod.config_map or "", sentence, time.time_ns())
        except RobotKubeError as error:
            self._process.log("no Kubernetes Event", error=str(error))

    def _command(self, sent: bytes) -> tuple[int, str]:
        """Answer POST /state with a body such as `{"state": "active"}`."""
        try:
            state = read_json(sent)["state"]
        except (ValueError, KeyError, TypeError):
            state = None
        if state not in STATES:
            return 400, json.dumps({"error": f'send {{"state": ...}} with one of {", ".join(STATES)}'})
        self._commands.append((state, time.time_ns()))
        return 202, json.dumps({"state": state})

    def _carried(self, type_name: str) -> str:
        return "" if self._broker is None else self._broker.definitions.get(type_name, "")

    def _definition(self, type_name: str) -> str:
        return definition(type_name, {} if self._broker is None else self._broker.definitions)

    def _journal_document(self) -> Mapping[str, Any]:
        return MEMORY_ONLY if self._journal is None else self._journal.document()

    def _unreachable(self) -> str:
        return "" if self._broker is None else self._broker.unreachable


def finish(turn: Callable[[], int], seconds: float) -> None:
    """Receive for so many seconds, then what has arrived already."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        time.sleep(BUSY_SECONDS)
        turn()
    deadline = time.monotonic() + LAST_DRAIN_SECONDS_MAX
    while turn() and time.monotonic() < deadline:
        time.sleep(BUSY_SECONDS)


def _on_thread(work: Callable[[], bool]) -> Callable[[], bool]:
    """Start work on a thread of its own; returns a function that waits for its result."""
    answers: list[bool] = []
    thread = threading.Thread(target=lambda: answers.append(work()), name="stop", daemon=True)
    thread.start()

    def answer() -> bool:
        thread.join(STORE_SECONDS_MAX + 1)
        return bool(answers and answers[0])

    return answer


def _leave(node: RosNode) -> None:
    """Leave the ROS graph, or publishers wait 20 s for a reader that is gone. The middleware may hang here."""
    thread = threading.Thread(target=node.close, name="leave", daemon=True)
    thread.start()
    thread.join(LEAVE_SECONDS_MAX)


def _process_age_seconds() -> float:
    """The seconds since the kernel started this process, interpreter and imports included."""
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
