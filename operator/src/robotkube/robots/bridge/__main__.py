"""Process of a bridge: `python3 -m robotkube.robots.bridge` (variables: docs/reference/robot-processes.md)."""

from __future__ import annotations

import gc
import json
import os
import sys
import time
from collections import deque
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from robotkube.errors import DocumentError, InputError
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.foundation.runtime.adapters.health_server import HealthServer
from robotkube.foundation.runtime.config_watch import fencing_of, watch_settings
from robotkube.foundation.runtime.loops.fencing import Fencing
from robotkube.foundation.runtime.loops.settings_report import SettingsReport
from robotkube.foundation.runtime.process import PodSettings, Process, read_text, run
from robotkube.robots.bridge.core.settings import BULK, SAFETY, TELEMETRY, check_agent, read_bridge_settings
from robotkube.robots.bridge.loops.bridge import NODE_NAME, Bridge
from robotkube.robots.bridge.loops.flows import SendingSession
from robotkube.robots.bridge.loops.link_reporting import LinkReporting
from robotkube.robots.mqtt.adapters.broker_account import read_broker_account
from robotkube.robots.mqtt.adapters.paho_channel import PahoChannel, wait
from robotkube.robots.ros.adapters.rclpy_node import RosNode

if TYPE_CHECKING:
    from robotkube.foundation.kubernetes.adapters.http_client import ConfigMapWatch
    from robotkube.robots.mqtt.ports import ChannelEvents

GRACE_SECONDS = 2.0
PERIOD_SECONDS = 0.04
YIELD_SECONDS = 0.01
SESSION_SECONDS = {SAFETY: 5, TELEMETRY: 60, BULK: 5}
PROMPT = (SAFETY, BULK)
"""Connections that are read as soon as something comes."""
KEY = "config.yaml"


def body(process: Process) -> None:
    """Wire the adapters to the service and turn it until the process shall end."""
    pod = PodSettings.from_environment()
    period = period_seconds(os.environ)
    session = int.from_bytes(os.urandom(8), "little")
    trace = os.urandom(16).hex()
    channels: dict[str, PahoChannel] = {}

    def channel(agent: str, name: str, events: ChannelEvents) -> PahoChannel:
        connection = "-".join([agent, *([pod.placed_node] if pod.placed_node else []), name])
        account = partial(read_broker_account, pod.broker_folder)  # read anew for each attempt
        channels[name] = PahoChannel(account, connection, SESSION_SECONDS[name], events, bounded=name != SAFETY)
        return channels[name]

    sender = SendingSession(session, time.time_ns, definition_of, trace)
    fencing = fencing_of(pod)
    bridge = Bridge(RosNode(NODE_NAME), channel, sender, process.log, fencing, reporting_of(pod, os.environ))
    settings = SettingsWatch(bridge, process, fencing)
    pages = {"/not_carried": lambda: json.dumps(bridge.not_carried)}
    HealthServer(ready=lambda: settings.complaint, metrics=settings.metrics, pages=pages, port=pod.health_port).start()
    settings.begin(read_text(pod.config_file, "the bridge's settings"), str(pod.config_file))
    if pod.config_map is not None:
        settings.watch(pod.config_map)
    gc.freeze()
    turn_bridge(process, bridge, settings, channels, period)
    bridge.close()


def turn_bridge(
    process: Process, bridge: Bridge, settings: SettingsWatch, channels: Mapping[str, PahoChannel], period: float
) -> None:
    """Turn the bridge every `period` seconds, and its connections whenever one of them can go on."""
    due = time.monotonic()
    while not process.stopping.is_set():
        settings.apply_changes()
        bridge.turn(time.monotonic())
        due = max(due + period, time.monotonic())
        while (left := due - time.monotonic()) > 0:
            prompt = [channels[name] for name in PROMPT if name in bridge.channels]
            writing = [channels[name] for name in bridge.channels if channels[name].wants_write]
            yielding = bool(bridge.yielding)
            if not prompt and not writing and not yielding:
                time.sleep(left)
            elif wait(writing, prompt, min(left, YIELD_SECONDS) if yielding else left) or yielding:
                bridge.turn_connections(time.monotonic())


class SettingsWatch:
    """Applies settings to the bridge: the mounted file at the beginning, then every change of the ConfigMap. Refused
    ones leave the old settings active; the bridge is not ready then, and a metric says so."""

    def __init__(self, bridge: Bridge, process: Process, fencing: Fencing) -> None:
        self._bridge = bridge
        self._process = process
        self._fencing = fencing
        self._changes: deque[tuple[str, str]] = deque(maxlen=1)
        self._report = SettingsReport()

    @property
    def complaint(self) -> str | None:
        """The reason why the bridge is not ready, or None."""
        if self._bridge.settings is None and self._report.refusal:
            return self._report.refusal
        return self._report.complaint or self._bridge.complaint

    def metrics(self) -> str:
        """The bridge's metrics and the state of its settings."""
        return f"{self._bridge.metrics()}{self._report.metrics()}{self._fencing.metrics()}"

    def begin(self, text: str, where: str) -> None:
        """Apply the first settings."""
        self._report.given(text)
        self.apply(text, where)

    def watch(self, config_map: str) -> ConfigMapWatch:
        """Watch the ConfigMap from now on."""
        where = f"ConfigMap {config_map}, key {KEY}"

        def changed(data: Mapping[str, str]) -> None:
            if KEY in data:
                self._report.given(data[KEY])
                self._changes.append((data[KEY], where))

        return watch_settings(self._process, config_map, self._fencing, changed)

    def apply_changes(self) -> None:
        """Apply the changes that the watch reported, then let the bridge send if it may, on the loop's thread."""
        held = self._fencing.fenced  # read first: what lifted it is among the changes by then
        while self._changes:
            self.apply(*self._changes.popleft())
        self._bridge.hold(held)

    def apply(self, text: str, where: str) -> None:
        """Apply settings, or keep the old ones and say why."""
        if text == self._report.at_work:
            return
        try:
            settings = read_bridge_settings(read_mapping(text, where), where)
            check_agent(self._bridge.settings, settings, where)
        except DocumentError as error:
            self._report.refused(text, str(error))
            self._process.log("settings refused", error=str(error), kept=self._bridge.settings is not None)
            return
        if settings != self._bridge.settings:
            self._bridge.configure(settings)
        self._report.taken(text)


def definition_of(type_name: str) -> str:
    """The definition of a type of this image with all it uses, or nothing."""
    from robotkube.robots.ros.adapters.installed_definitions import definition  # only who publishes types needs it

    return definition(type_name, Path(sys.prefix) / "share")


def reporting_of(pod: PodSettings, environment: Mapping[str, str]) -> LinkReporting | None:
    """The reporting of a release's bridge; None where it is none's, or does not know its pod."""
    name = environment.get("HOSTNAME", "")
    if pod.config_map is None or not name:
        return None
    return LinkReporting(pod.config_map.rpartition("/")[2], name, time.time_ns())


def period_seconds(environment: Mapping[str, str]) -> float:
    """ROBOTKUBE_PERIOD_MS, or the default; InputError when it is no number from 1 to 1000."""
    text = environment.get("ROBOTKUBE_PERIOD_MS")
    if text is None:
        return PERIOD_SECONDS
    if not text.isdecimal() or not 1 <= int(text) <= 1000:
        raise InputError(f"ROBOTKUBE_PERIOD_MS is {text!r}; give whole milliseconds from 1 to 1000")
    return int(text) / 1000


def main() -> None:
    """Run until SIGTERM or the end of the work; exit codes as in `foundation.runtime.process`."""
    run("mqtt-bridge", body, GRACE_SECONDS)


if __name__ == "__main__":
    main()
