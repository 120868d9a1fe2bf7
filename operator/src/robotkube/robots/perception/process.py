"""The process around object-detection and object-tracking: settings that are watched, health, the end on SIGTERM.

Both work off their input every PERIOD_SECONDS, without an executor. Variables: docs/reference/robot-processes.md.
"""

from __future__ import annotations

import gc
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Protocol, TypeVar

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.foundation.runtime.adapters.health_server import HealthServer
from robotkube.foundation.runtime.config_watch import fencing_of, watch_settings
from robotkube.foundation.runtime.loops.settings_report import SettingsReport
from robotkube.foundation.runtime.process import PodSettings, Process, read_text
from robotkube.robots.perception.loops.service import Log, MessageProcessor
from robotkube.robots.ros.adapters.rclpy_node import RosNode

GRACE_SECONDS = 2.0
PERIOD_SECONDS = 0.02
KEY = "config.yaml"

Settings = TypeVar("Settings")
AppliedSettings = TypeVar("AppliedSettings", contravariant=True)


class PerceptionService(Protocol[AppliedSettings]):
    """A perception service whose settings may change while it runs."""

    @property
    def processor(self) -> MessageProcessor:
        """Its topics and counters."""
        ...

    def configure(self, settings: AppliedSettings) -> None:
        """Apply settings."""
        ...


def serve(
    process: Process,
    node: str,
    make: Callable[[RosNode, Log], PerceptionService[Settings]],
    read: Callable[[Mapping[str, Any], str], Settings],
) -> None:
    """Run one service until the process shall end. InputError when its first settings are refused."""
    pod = PodSettings.from_environment()
    first = read_text(pod.config_file, "the settings")
    settings = read(read_mapping(first, str(pod.config_file)), str(pod.config_file))
    report = SettingsReport()
    report.given(first)
    service = make(RosNode(node), process.log)
    processor = service.processor
    fencing = fencing_of(pod)
    HealthServer(
        ready=lambda: report.complaint or processor.complaint,
        metrics=lambda: processor.metrics() + report.metrics() + fencing.metrics(),
        port=pod.health_port,
    ).start()
    service.configure(settings)
    report.taken(first)
    changes: deque[str] = deque(maxlen=1)
    if pod.config_map is not None:
        watch_settings(process, pod.config_map, fencing, lambda data: _note(changes, report, data))
    process.log("ready", complaint=processor.complaint)
    gc.freeze()
    while not process.stopping.wait(PERIOD_SECONDS):
        fenced = fencing.fenced  # read first: what lifted it is among the changes by then
        if changes:
            _apply(process, service, read, report, changes.popleft())
        if not fenced:
            processor.turn()
    processor.close()


def _apply(
    process: Process,
    service: PerceptionService[Settings],
    read: Callable[[Mapping[str, Any], str], Settings],
    report: SettingsReport,
    text: str,
) -> None:
    """Apply changed settings; refused ones are reported and the present ones stay."""
    try:
        service.configure(read(read_mapping(text, KEY), KEY))
        report.taken(text)
    except DocumentError as error:
        report.refused(text, str(error))
        process.log("settings refused", error=str(error))


def _note(changes: deque[str], report: SettingsReport, data: Mapping[str, str]) -> None:
    if KEY in data:
        report.given(data[KEY])
        changes.append(data[KEY])
