"""Objects of a release, and the images that its pods would run, by its chart and values: what templates make of values
is known only once they are rendered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

from robotkube.registry.charts.core.pod_images import pod_images
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.charts.core.values_schemas import overlay
from robotkube.registry.charts.ports import ChartProgram, ChartRegistry

CHARTS_KEPT_MAX = 64


class ReleaseObjects:
    """The port RenderedObjects: releases are rendered by `program` as Argo CD renders them; charts come by digest from
    the first of `organisations` of the OCI registry that has them, and the files of the last CHARTS_KEPT_MAX are
    kept."""

    def __init__(self, registry: ChartRegistry, organisations: Sequence[str], program: ChartProgram) -> None:
        self._registry = registry
        self._organisations = tuple(organisations)
        self._program = program
        self._files = lru_cache(CHARTS_KEPT_MAX)(self._pull)

    def __call__(
        self, chart: ChartReference, values: Mapping[str, Any], plan: str, release: str, namespace: str
    ) -> Sequence[Mapping[str, Any]]:
        """All objects. InputError when the chart cannot be rendered with these values, UnavailableError when the OCI
        registry or the program is away."""
        files = self._files(chart.name, chart.digest)
        return self._program.render(files, overlay(values, {"global": {"plan": plan}}), release, namespace)

    def _pull(self, chart: str, digest: str) -> Mapping[str, bytes]:
        places = [f"{organisation}/{chart}" for organisation in self._organisations]
        there = (place for place in places[:-1] if self._registry.manifest_digest(place, digest))
        return self._registry.pull_chart(next(there, places[-1]), digest).files


class ReleaseImages:
    """The port RenderedImages: the images in the objects of releases whose charts are in `organisation`."""

    def __init__(self, registry: ChartRegistry, organisation: str, program: ChartProgram) -> None:
        self._objects = ReleaseObjects(registry, (organisation,), program)

    def __call__(
        self, chart: ChartReference, values: Mapping[str, Any], plan: str, release: str, namespace: str
    ) -> tuple[str, ...]:
        """References of all images, sorted; errors as those of ReleaseObjects."""
        return pod_images(self._objects(chart, values, plan, release, namespace))
