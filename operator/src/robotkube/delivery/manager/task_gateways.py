"""The manager's MQTT task gateway on its adapters."""

from __future__ import annotations

import functools
import time
from collections.abc import Mapping

from kubernetes.client import ApiClient

from robotkube.delivery.tasks.adapters.kubernetes_tasks import KubernetesTasks
from robotkube.delivery.tasks.adapters.paho_gateway import PahoGateway
from robotkube.delivery.tasks.loops.device_holds import DeviceHolds
from robotkube.delivery.tasks.loops.link_reports import LinkReports
from robotkube.delivery.tasks.loops.mqtt_gateway import MqttTaskGateway
from robotkube.delivery.tasks.ports.store import TaskStore
from robotkube.foundation.kubernetes.adapters.client import call
from robotkube.foundation.kubernetes.ports import Leadership
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount

STOP_SECONDS_MAX = 2.0


def task_gateway(
    broker: BrokerAccount,
    operators: Mapping[str, str],
    api: ApiClient,
    store: TaskStore,
    leadership: Leadership,
    holds: DeviceHolds,
    links: LinkReports,
) -> MqttTaskGateway:
    """The MQTT task gateway for `operators` (name -> namespace of its tasks); it does not connect before its start."""
    session = f"{broker.username}-task-door"
    channel = PahoGateway(broker, session)
    writer = KubernetesTasks(functools.partial(call, api))
    clocks = (time.time_ns, time.monotonic)
    return MqttTaskGateway(operators, channel, store, writer, leadership, *clocks, holds.receive, links.receive)
