"""The manager's metrics page and, when the settings name a collector, its traces.

traces: {endpoint: "http://collector.observability.svc:4318/v1/traces"}     optional; without it nothing is traced
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from robotkube.adapters.metrics_prometheus import PrometheusMetrics
from robotkube.domain.documents import Reader
from robotkube.domain.holds import Hold
from robotkube.entrypoints import settings as files
from robotkube.ports.clusters import Cluster, TaskStore
from robotkube.services.application_manager import ApplicationManager
from robotkube.services.manager_figures import FigureReader


def read_traces(reader: Reader, value: Any) -> str:
    """The collector's address; empty when traces are off."""
    if value is None:
        return ""
    found: Mapping[str, Any] = reader.mapping(value, "traces", ["endpoint"])
    return reader.word(found.get("endpoint"), "traces.endpoint", files.HTTP_URL)


class ManagerTelemetry:
    """Listens to one manager; `text` is the page /metrics, `close` sends the traces that wait."""

    def __init__(
        self,
        manager: ApplicationManager,
        store: TaskStore,
        cluster: Cluster,
        agents: Collection[str],
        holds: Callable[[], Sequence[Hold]],
        endpoint: str,
        name: str,
    ) -> None:
        statistics = manager.statistics

        def held() -> int:
            by_label = {node.agent for node in cluster.nodes() if node.hold is not None}
            return len(by_label | {hold.agent for hold in holds()})

        figures = FigureReader(
            store,
            cluster,
            frozenset(agents),
            broken=lambda: statistics.broken_files,
            holds=held,
            leading=lambda: statistics.term > 0,
        )
        metrics = PrometheusMetrics(figures.read)
        self.text, self.close = metrics.text, _nothing
        statistics.listeners = (metrics,)
        if endpoint:
            from robotkube.adapters.traces_opentelemetry import OpenTelemetryTraces  # only when wanted: 0.2 s of start

            traces = OpenTelemetryTraces(endpoint, name)
            statistics.listeners, self.close = (metrics, traces), traces.close


def _nothing() -> None:
    """Without traces nothing waits."""
