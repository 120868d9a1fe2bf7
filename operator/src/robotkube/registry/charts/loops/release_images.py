"""Images that a release's pods would run, by its chart and values: what templates make of values is known only once
they are rendered."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from robotkube.registry.charts.core.pod_images import pod_images
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.charts.core.values_schemas import overlay
from robotkube.registry.charts.ports import ChartProgram, ChartRegistry

CHARTS_KEPT_MAX = 64


class ReleaseImages:
    """The port RenderedImages: releases are rendered by `program` as Argo CD renders them; charts come from
    `organisation` of the OCI registry, by digest, and the files of the last CHARTS_KEPT_MAX are kept."""

    def __init__(self, registry: ChartRegistry, organisation: str, program: ChartProgram) -> None:
        self._program = program
        self._files = lru_cache(CHARTS_KEPT_MAX)(
            lambda chart, digest: registry.pull_chart(f"{organisation}/{chart}", digest).files
        )

    def __call__(
        self, chart: ChartReference, values: Mapping[str, Any], plan: str, release: str, namespace: str
    ) -> tuple[str, ...]:
        """References of all images, sorted. InputError when the chart cannot be rendered with these values,
        UnavailableError when the OCI registry or the program is away."""
        files = self._files(chart.name, chart.digest)
        given = overlay(values, {"global": {"plan": plan}})
        return pod_images(self._program.render(files, given, release, namespace))
