"""The facts of a preflight, each with what reads it: the cluster, the chart as Helm renders it, registries."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robotkube.delivery.preflight.adapters.calls_at_once import at_once
from robotkube.delivery.preflight.adapters.chart_sources import PlatformChart
from robotkube.delivery.preflight.adapters.cluster_facts import ClusterFacts
from robotkube.delivery.preflight.adapters.registry_answers import RegistryQuestions
from robotkube.delivery.preflight.core import argocd, kinds, owners, rights
from robotkube.delivery.preflight.core.registries import RegistryAnswer, hosts
from robotkube.delivery.preflight.core.renderings import RenderedChart
from robotkube.delivery.preflight.core.values import Judgement, completed, without_value
from robotkube.delivery.preflight.loops.reading import FactReading
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.adapters.json_schema import violations
from robotkube.foundation.kubernetes.core.service_names import service_of
from robotkube.registry.charts.adapters.helm import LACKING, REFUSED, HelmProgram

SECONDS_MAX = 7.0
RENDERING_SECONDS_MAX = 5.0
Reader = Callable[[FactReading], Any]


@dataclass(frozen=True)
class HelmAnswer:
    """What helm made of the chart: its objects, or why it refuses."""

    objects: Sequence[Mapping[str, Any]] = ()
    refusal: str = ""


@dataclass(frozen=True)
class Preflight:
    """What is to be looked at: `chart` as `release` in `namespace` of a cluster, with the values `given`, or None for
    those of the release that is there. `helm` is the program's path; empty: there is none."""

    cluster: ClusterFacts
    registries: RegistryQuestions
    chart: PlatformChart = field(repr=False)
    given: Mapping[str, Any] | None = field(repr=False)
    release: str
    namespace: str
    helm: str

    def facts(self) -> dict[str, Any]:
        """All facts, read within SECONDS_MAX."""
        return FactReading({**self._of_chart(), **self._of_cluster()}, SECONDS_MAX).facts()

    def _of_chart(self) -> dict[str, Reader]:
        return {
            "chart": lambda _: self.chart.metadata,
            "given": self._given,
            "settings": lambda facts: completed(self.chart.defaults, facts.needed("given")),
            "rendered": self._rendered,
            "rendering": self._rendering,
            "judgement": self._judgement,
            "registries": self._registries,
        }

    def _of_cluster(self) -> dict[str, Reader]:
        cluster = self.cluster
        return {
            "version": lambda _: cluster.version(),
            "release": lambda _: cluster.release(self.release, self.namespace),
            "installed": lambda facts: facts.needed("release") is not None,
            "namespace": lambda _: cluster.in_namespace(self.namespace),
            "namespaces": lambda _: cluster.namespaces(),
            "nodes": lambda _: cluster.nodes(),
            "pods": lambda _: cluster.pods(),
            "storage": lambda _: cluster.storage(),
            "judges": lambda _: cluster.judges(),
            "control_groups": lambda facts: cluster.control_groups(facts.needed("nodes")),
            "argocd": lambda facts: cluster.argocd(argocd.namespace_in(facts.needed("settings"))),
            "served": lambda facts: cluster.served(kinds.versions(facts.needed("rendering"))),
            "standing": lambda facts: cluster.standing(owners.owned_objects(facts.needed("rendering"))),
            "rights": lambda facts: cluster.rights(rights.needed_rights(facts.needed("rendering"))),
        }

    def _given(self, facts: FactReading) -> Mapping[str, Any]:
        if self.given is not None:
            return self.given
        present = facts.needed("release")
        return present.values if present is not None else {}

    def _rendered(self, facts: FactReading) -> HelmAnswer:
        given = facts.needed("given")
        if not self.helm:
            raise UnavailableError(LACKING)
        seconds = min(RENDERING_SECONDS_MAX, facts.left())
        with tempfile.TemporaryDirectory(prefix="robotkube-preflight-") as work:
            program = HelmProgram(self.helm, Path(work), clock_seconds=seconds)
            try:
                return HelmAnswer(program.render(self.chart.files, given, self.release, self.namespace))
            except InputError as error:
                if not str(error).startswith(REFUSED):
                    raise
                return HelmAnswer(refusal=str(error).removeprefix(REFUSED))

    def _rendering(self, facts: FactReading) -> RenderedChart:
        rendered = facts.needed("rendered")
        if rendered.refusal:
            raise UnavailableError("absent: the chart refuses the values, so nothing is rendered (see check values)")
        return RenderedChart(rendered.objects, self.release, self.namespace)

    def _judgement(self, facts: FactReading) -> Judgement:
        settings = facts.needed("settings")
        problems = [
            (path, without_value(words, settings, path)) for path, words in violations(self.chart.schema, settings)
        ]
        source = "--values" if self.given is not None else "the release that is there"
        if self.given is None and facts.needed("release") is None:
            source = "the chart's defaults, since no --values are given and no release is there"
        return Judgement(problems, "" if problems else facts.needed("rendered").refusal, source)

    def _registries(self, facts: FactReading) -> Mapping[str, RegistryAnswer]:
        named = hosts(facts.needed("rendering").objects)
        return dict(zip(named, at_once([functools.partial(self._registry, host) for host in named]), strict=True))

    def _registry(self, host: str) -> RegistryAnswer:
        service = service_of(host)
        if service is None:
            return self.registries.ask(host)
        present = self.cluster.service(*service)
        if present is None:
            return RegistryAnswer(silent="absent: it is the platform's own, which the chart makes")
        port = host.partition(":")[2] or "80"
        return self.registries.ask_service(f"{present['spec'].get('clusterIP', '')}:{port}")
