"""The manager's metrics page and, when the settings name a collector, its traces.

traces: {endpoint: "http://collector.observability.svc:4318/v1/traces"}     optional; without it nothing is traced
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robotkube.delivery.manager.adapters.prometheus import PrometheusMetrics
from robotkube.delivery.manager.loops.gauges import GaugeReader
from robotkube.delivery.manager.loops.reconciler import ApplicationManager
from robotkube.delivery.manager.ports.cluster import Cluster
from robotkube.delivery.tasks.core.holds import DeviceHold
from robotkube.delivery.tasks.ports.store import TaskStore
from robotkube.foundation.documents.core.patterns import HTTP_URL
from robotkube.foundation.documents.core.reader import Reader


def read_traces(reader: Reader, value: Any) -> str:
    """Read the collector's address; empty when traces are off."""
    if value is None:
        return ""
    traces: Mapping[str, Any] = reader.mapping(value, "traces", ["endpoint"])
    return reader.word(traces.get("endpoint"), "traces.endpoint", HTTP_URL)


class ManagerTelemetry:
    """The metrics and traces of one manager; `text` is the page /metrics, `close` sends the traces that wait."""

    def __init__(
        self,
        manager: ApplicationManager,
        store: TaskStore,
        cluster: Cluster,
        holds: Callable[[], Sequence[DeviceHold]],
        endpoint: str,
        name: str,
    ) -> None:
        statistics = manager.statistics

        def held() -> int:
            by_label = {node.agent for node in cluster.nodes() if node.hold is not None}
            return len(by_label | {hold.agent for hold in holds()})

        gauges = GaugeReader(
            store,
            cluster,
            lambda: {agent.name for agent in manager.planner.agents},
            broken=lambda: statistics.broken_files,
            holds=held,
            updates=lambda: statistics.updates.states,
            leading=lambda: statistics.term > 0,
        )
        metrics = PrometheusMetrics(gauges.read)
        self.text = metrics.text
        self.close = _close_nothing
        statistics.listeners = (metrics,)
        if endpoint:
            from robotkube.delivery.manager.adapters.opentelemetry import (
                OpenTelemetryTraces,  # only when wanted: 0.2 s of start
            )

            traces = OpenTelemetryTraces(endpoint, name)
            statistics.listeners = (metrics, traces)
            self.close = traces.close


def _close_nothing() -> None:
    """Do nothing: without traces no span waits."""
