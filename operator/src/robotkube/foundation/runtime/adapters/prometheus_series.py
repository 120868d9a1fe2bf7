"""Metrics in Prometheus' text form (prometheus-client), out of what a process counts by itself."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from robotkube.foundation.runtime.ports import Series

Source = Callable[[], Iterable[Series]]


class MetricsPage:
    """The page /metrics of a process: what its `sources` count at the moment of a reading, and the process's own."""

    def __init__(self, *sources: Source) -> None:
        self._registry = CollectorRegistry()
        ProcessCollector(registry=self._registry)
        self._registry.register(_Families(*sources))

    def text(self) -> str:
        """The page, for any thread."""
        return generate_latest(self._registry).decode()


def series_text(series: Iterable[Series]) -> str:
    """These alone, as a part of a page."""
    registry = CollectorRegistry()
    registry.register(_Families(lambda: series))
    return generate_latest(registry).decode()


class _Families(Collector):
    def __init__(self, *sources: Source) -> None:
        self._sources = sources

    def describe(self) -> Iterable[Metric]:
        """Nothing: the names are known only when somebody reads."""
        return ()

    def collect(self) -> Iterator[Metric]:
        """One family per series."""
        for source in self._sources:
            yield from map(_family, source())


def _family(one: Series) -> Metric:
    form = CounterMetricFamily if one.kind == "counter" else GaugeMetricFamily
    family = form(one.name, one.text, labels=one.labels)
    for labels, value in sorted(one.values.items()):
        family.add_metric(labels, value)
    return family
