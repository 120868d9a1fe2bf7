"""The manager's MQTT task gateway: its settings, and its adapters."""

from __future__ import annotations

import functools
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from kubernetes.client import ApiClient

from robotkube.delivery.tasks.adapters.kubernetes_tasks import KubernetesTasks
from robotkube.delivery.tasks.adapters.paho_gateway import PahoGateway
from robotkube.delivery.tasks.loops.device_holds import DeviceHolds
from robotkube.delivery.tasks.loops.mqtt_gateway import MqttTaskGateway
from robotkube.delivery.tasks.ports.store import TaskStore
from robotkube.foundation.documents.core.patterns import WORD
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.kubernetes.adapters.client import call
from robotkube.foundation.kubernetes.ports import Leadership
from robotkube.foundation.runtime import settings_file as files

STOP_SECONDS_MAX = 2.0


@dataclass(frozen=True)
class BrokerSettings:
    """The address of the broker, and the manager's account there."""

    host: str
    port: int
    account: files.Credentials


def read_broker(reader: Reader, value: Any) -> BrokerSettings | None:
    """Read the optional key `broker`; None without it: then there is no MQTT task gateway."""
    if value is None:
        return None
    broker = reader.mapping(value, "broker", ["host", "port", "credentials"])
    port = broker.get("port")
    if not isinstance(port, int) or isinstance(port, bool) or not 1 <= port <= files.PORT_MAX:
        reader.problems.append(f"broker.port: must be a whole number from 1 to {files.PORT_MAX}")
        port = 0
    account = files.credentials(reader, broker.get("credentials"), "broker.credentials")
    return BrokerSettings(reader.word(broker.get("host"), "broker.host", WORD), port, account)


def task_gateway(
    settings: BrokerSettings,
    operators: Mapping[str, str],
    api: ApiClient,
    store: TaskStore,
    leadership: Leadership,
    holds: DeviceHolds,
) -> MqttTaskGateway:
    """The MQTT task gateway for `operators` (name -> namespace of its tasks); it does not connect before its start."""
    account = settings.account
    session = f"{account.username}-task-door"
    channel = PahoGateway(settings.host, settings.port, account.username, account.password, session)
    writer = KubernetesTasks(functools.partial(call, api))
    return MqttTaskGateway(operators, channel, store, writer, leadership, time.time_ns, time.monotonic, holds.receive)
