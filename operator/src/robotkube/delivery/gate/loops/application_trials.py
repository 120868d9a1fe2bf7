"""Trials of applications: each is composed for samples of its parameters, by the code that the manager composes with,
what comes out is rendered, and the objects are checked.

A sample proves nothing of the parameters that it leaves out: that a release runs verified images only is checked again
on the release itself. What a trial finds, its author learns before the application is published.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.gate.core.application_compositions import ApplicationCompositions, releases
from robotkube.delivery.gate.core.application_samples import Parameters
from robotkube.delivery.gate.core.rendered_checks import rendered_problems
from robotkube.errors import InputError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.registry.catalogue.core.catalogue import NONE, Catalogue, ChartVersion
from robotkube.registry.catalogue.loops.verified_catalogue import EvidenceReader, read_policy
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.charts.core.values_schemas import SAMPLE_PLAN, Validate
from robotkube.registry.charts.ports import RenderedObjects
from robotkube.registry.evidence.core.application_statements import TrialResult
from robotkube.registry.evidence.core.verification_policy import VerificationPolicy

SECONDS_MAX = 60.0  # of all applications of one call
RELEASES_MAX = 500  # different ones of one application


class CompositionTrials:
    """The port ApplicationTrials. `reader` assesses the catalogue's evidence, `objects` renders releases of charts that
    are published or submitted, `monotonic` is a clock in seconds that never goes back."""

    def __init__(
        self,
        reader: EvidenceReader,
        render: Render,
        validate: Validate,
        objects: RenderedObjects,
        monotonic: Callable[[], float],
    ) -> None:
        self._reader = reader
        self._render = render
        self._validate = validate
        self._objects = objects
        self._monotonic = monotonic

    def __call__(
        self, files: Mapping[str, str], names: Collection[str], submitted: Collection[ChartReference] = ()
    ) -> Mapping[str, TrialResult]:
        """The result for each of the applications `names` in a catalogue with these files, in which the chart versions
        `submitted` count as verified; nothing while it has no verification policy. UnavailableError when charts cannot
        be rendered now."""
        policy, _ = read_policy(files)
        if policy is None:
            return {}
        until = self._monotonic() + SECONDS_MAX
        catalogue = _as_published(self._reader.read(files), submitted)
        schemas = _Schemas(files)
        results = {}
        for name in sorted(set(names) & set(catalogue.applications)):
            compositions = ApplicationCompositions(name, catalogue, schemas, self._render, self._validate)
            trial = _Trial(compositions, policy)
            results[name] = trial.result(self._objects, lambda: self._monotonic() > until)
        return results


def _as_published(catalogue: Catalogue, submitted: Collection[ChartReference]) -> Catalogue:
    """The catalogue as it is once the submission is published: its charts are verified, its applications tried."""
    charts = {
        chart: tuple(_verified(version) if version.reference in submitted else version for version in versions)
        for chart, versions in catalogue.charts.items()
    }
    return replace(catalogue, charts=charts, application_assurance=NONE)


def _verified(version: ChartVersion) -> ChartVersion:
    return replace(version, state="verified", assured=True, evidence_problem="")


class _Schemas:
    """Values schemas of chart versions among files."""

    def __init__(self, files: Mapping[str, str]) -> None:
        self._files = files
        self._read: dict[str, Mapping[str, Any] | None] = {}

    def __call__(self, chart: str, version: str) -> Mapping[str, Any] | None:
        path = f"charts/{chart}/{version}.schema.json"
        if path not in self._read:
            self._read[path] = _schema(self._files.get(path))
        return self._read[path]


def _schema(text: str | None) -> Mapping[str, Any] | None:
    try:
        schema = read_json(text) if text is not None else None
    except ValueError:
        return None
    return schema if isinstance(schema, dict) else None


class _Trial:
    """The trial of one application, whose `compositions` are made for it."""

    def __init__(self, compositions: ApplicationCompositions, policy: VerificationPolicy) -> None:
        self._compositions = compositions
        self._catalogue = compositions.catalogue
        self._policy = policy

    def result(self, objects: RenderedObjects, late: Callable[[], bool]) -> TrialResult:
        """What the trial finds, as far as it comes until it is `late`; UnavailableError when `objects` cannot be had
        now."""
        samples = self._compositions.samples()
        tried = self._compositions.composed(samples, late) if samples else []
        made = releases(tried or [])
        if tried is None or not self._render_all(made, objects, late):
            return _unfinished()
        charts = {ChartReference(release.chart, release.version, release.digest) for release, _ in made}
        problems = tuple(f"{key}: {text}" for key, text in self._compositions.problems)
        return TrialResult(problems, tuple(sorted(charts)), len(samples), len(made))

    def _render_all(
        self, made: Sequence[tuple[Release, Parameters]], objects: RenderedObjects, late: Callable[[], bool]
    ) -> bool:
        """Render and check every release; False when they are too many, or it gets late."""
        for number, (release, parameters) in enumerate(made):
            if number >= RELEASES_MAX or late():
                return False
            for rule, problem in self._rendered(release, objects):
                key = self._place(release)
                text = f"{problem}; release {release.key} of chart {release.chart} {release.version}"
                self._compositions.report((rule, key, release.chart, release.version), key, text, parameters)
        return True

    def _rendered(self, release: Release, objects: RenderedObjects) -> Sequence[tuple[str, str]]:
        version = self._catalogue.version(release.chart, release.version)
        assert version is not None
        try:
            made = objects(version.reference, release.values, SAMPLE_PLAN, release.name, release.namespace)
        except InputError as error:
            return [("renders", str(error))]
        return list(rendered_problems(release, version, made, self._catalogue, self._policy))

    def _place(self, release: Release) -> str:
        """The place in the application's document that the release comes from: services that may get its chart, or
        links."""
        reference = (release.chart, release.version)
        services = [
            f"spec.services[{index}]"
            for index, service in enumerate(self._compositions.application.services)
            if reference in {(c.chart, c.version) for c in self._catalogue.candidates(service.chart)}
        ]
        return " or ".join(services) or "spec.links"


def _unfinished() -> TrialResult:
    """The result of a trial that met its bounds."""
    bounds = f"{RELEASES_MAX} different releases, or {SECONDS_MAX:.0f} s with the others"
    fix = "have fewer parameters with fewer values, or charts that render faster, or submit fewer at once"
    return TrialResult((f"spec: to try it needs more than {bounds}; {fix}",), finished=False)
