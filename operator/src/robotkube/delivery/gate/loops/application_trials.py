"""Trials of applications: each is composed for samples of its parameters, by the code that the manager composes with,
what comes out is rendered, and the objects are checked.

A sample proves nothing of the parameters that it leaves out: that a release runs verified images only is checked again
on the release itself. What a trial finds, its author learns before the application is published.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.gate.core.application_samples import (
    Parameters,
    demand,
    inventory,
    sampled_parameters,
    ways,
    with_subject,
)
from robotkube.delivery.gate.core.rendered_checks import rendered_problems
from robotkube.delivery.manager.core.composition.composer import Composition, Inputs, Refused, compose
from robotkube.errors import InputError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.registry.catalogue.core.catalogue import NONE, Catalogue, ChartVersion, Pin
from robotkube.registry.catalogue.core.versions import version_key
from robotkube.registry.catalogue.loops.verified_catalogue import EvidenceReader, read_policy
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.charts.core.values_schemas import SAMPLE_PLAN, Validate
from robotkube.registry.charts.ports import RenderedObjects
from robotkube.registry.evidence.core.application_statements import TrialResult
from robotkube.registry.evidence.core.verification_policy import VerificationPolicy

SECONDS_MAX = 60.0  # of all applications of one call
RELEASES_MAX = 500  # different ones of one application
OLDER_VERSIONS = 3  # of a chart, that are tried besides the one that is selected
OLDER_SAMPLES = 3
PROBLEMS_MAX = 20
PARAMETERS_SHOWN_MAX = 200
WRONG = frozenset(
    {
        "CompositionFailed",
        "NoVerifiedVersion",
        "GuaranteeNotMet",
        "UnknownApplication",
        "LinkTypeUnknown",
        "LinkMismatch",
    }
)
"""Refusals that the application is to blame for; others say that the sampled fleet cannot serve a sample."""
NOT_SELECTED = frozenset({"NoVerifiedVersion", "GuaranteeNotMet"})


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
            trial = _Trial(name, catalogue, policy, schemas, self._render, self._validate)
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


@dataclass(frozen=True)
class _Tried:
    """One composition: the parameters, and what came out."""

    parameters: Parameters
    composition: Composition

    @property
    def refused(self) -> Refused | None:
        outcome = next(iter(self.composition.outcomes.values()))
        return outcome if isinstance(outcome, Refused) else None


class _Trial:
    """The trial of one application."""

    def __init__(
        self,
        name: str,
        catalogue: Catalogue,
        policy: VerificationPolicy,
        schema: _Schemas,
        render: Render,
        validate: Validate,
    ) -> None:
        self._application = catalogue.applications[name]
        self._catalogue, self._subject = with_subject(catalogue, name)
        self._policy = policy
        self._schema = schema
        self._render = render
        self._validate = validate
        self._problems: dict[tuple[str, ...], str] = {}

    def result(self, objects: RenderedObjects, late: Callable[[], bool]) -> TrialResult:
        """What the trial finds, as far as it comes until it is `late`; UnavailableError when `objects` cannot be had
        now."""
        samples = sampled_parameters(self._subject, self._validate)
        if not samples:
            text = "no set of values was found that the schema accepts; add `examples: [...]` to the parameters"
            return TrialResult((f"spec.parameters: {text}",))
        by_way = {way: [self._composed(way, one) for one in samples if not late()] for way in ways(self._subject)}
        if late():
            return _unfinished()
        way = min(by_way, key=lambda one: (len(_wrong(by_way[one])), -len(_met(by_way[one]))))
        self._report_refusals(by_way[way])
        tried = [one for compositions in by_way.values() for one in compositions]
        tried += self._with_older_versions(way, samples[:OLDER_SAMPLES], tried)
        releases = _releases(tried)
        if not self._render_all(releases, objects, late):
            return _unfinished()
        charts = {ChartReference(release.chart, release.version, release.digest) for release, _ in releases}
        problems = tuple(self._problems.values())
        return TrialResult(problems[:PROBLEMS_MAX], tuple(sorted(charts)), len(samples), len(releases))

    # -- composing ------------------------------------------------------------------------------------------------

    def _composed(self, way: str, parameters: Parameters, withheld: Mapping[Pin, str] | None = None) -> _Tried:
        """The composition of the one demand for the application with these parameters."""
        fleet = inventory(self._subject, parameters, self._render)
        inputs = Inputs(
            *(self._catalogue, fleet, {}, self._render, self._validate), withheld=withheld or {}, schema=self._schema
        )
        return _Tried(parameters, compose([demand(self._subject, parameters, way)], inputs))

    def _report_refusals(self, tried: Sequence[_Tried]) -> None:
        for one in _wrong(tried):
            assert one.refused is not None
            self._report((one.refused.reason, one.refused.message), "spec", one.refused.message, one.parameters)
        if not self._problems and not _met(tried):
            refused = tried[0].refused
            words = f"{refused.reason}: {refused.message}" if refused else ""
            fix = "give the parameters `examples` that name agents, or widen the placements"
            self._report(("nothing",), "spec", f"no sample could be composed: {words}; {fix}", tried[0].parameters)

    def _with_older_versions(
        self, way: str, samples: Sequence[Parameters], tried: Sequence[_Tried]
    ) -> Sequence[_Tried]:
        """Compositions with versions that would be selected if newer ones were withdrawn, or that releases keep."""
        older = []
        for chart, withheld in self._older_versions(_releases(tried)):
            composed = [self._composed(way, one, withheld) for one in samples]
            served = [one for one in composed if one.refused is None or one.refused.reason not in NOT_SELECTED]
            for one in _wrong(served):
                assert one.refused is not None
                fix = f"narrow the range of chart {chart}"
                self._report((one.refused.message,), "spec", f"{one.refused.message}; {fix}", one.parameters)
            older += served
        return older

    def _older_versions(
        self, releases: Sequence[tuple[Release, Parameters]]
    ) -> Iterator[tuple[str, Mapping[Pin, str]]]:
        """For every allowed version beside those that were selected: its chart, and what is withheld to select it."""
        selected = {(release.chart, release.version) for release, _ in releases}
        for chart in sorted({chart for chart, _ in selected}):
            versions = self._catalogue.charts[chart]
            others = [v for v in versions if not self._catalogue.allows(v) and (chart, v.version) not in selected]
            others.sort(key=lambda version: version_key(version.version), reverse=True)
            for version in others[:OLDER_VERSIONS]:
                yield chart, {(chart, v.version): "another one is tried" for v in versions if v is not version}

    # -- rendering ------------------------------------------------------------------------------------------------

    def _render_all(
        self, releases: Sequence[tuple[Release, Parameters]], objects: RenderedObjects, late: Callable[[], bool]
    ) -> bool:
        """Render and check every release; False when they are too many, or it gets late."""
        for number, (release, parameters) in enumerate(releases):
            if number >= RELEASES_MAX or late():
                return False
            for rule, problem in self._rendered(release, objects):
                key = self._place(release)
                text = f"{problem}; release {release.key} of chart {release.chart} {release.version}"
                self._report((rule, key, release.chart, release.version), key, text, parameters)
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
        """Where in the application's document the release comes from: services that may get its chart, or links."""
        reference = (release.chart, release.version)
        services = [
            f"spec.services[{index}]"
            for index, service in enumerate(self._application.services)
            if reference in {(c.chart, c.version) for c in self._catalogue.candidates(service.chart)}
        ]
        return " or ".join(services) or "spec.links"

    def _report(self, about: tuple[str, ...], key: str, text: str, parameters: Parameters) -> None:
        """Report a problem; the same one of other samples only once."""
        shown = f"{dict(parameters)!r:.{PARAMETERS_SHOWN_MAX}}"  # first: what shows reports may cut long ones
        self._problems.setdefault(about, f"{key}: with parameters {shown}: {text}")


def _unfinished() -> TrialResult:
    """The result of a trial that met its bounds."""
    bounds = f"{RELEASES_MAX} different releases, or {SECONDS_MAX:.0f} s with the others"
    fix = "have fewer parameters with fewer values, or charts that render faster, or submit fewer at once"
    return TrialResult((f"spec: to try it needs more than {bounds}; {fix}",), finished=False)


def _wrong(tried: Sequence[_Tried]) -> Sequence[_Tried]:
    """The compositions that failed for a reason that the application is to blame for."""
    return [one for one in tried if one.refused is not None and one.refused.reason in WRONG]


def _met(tried: Sequence[_Tried]) -> Sequence[_Tried]:
    return [one for one in tried if one.refused is None]


def _releases(tried: Sequence[_Tried]) -> Sequence[tuple[Release, Parameters]]:
    """Every different release, with the first parameters that gave it."""
    found: dict[str, tuple[Release, Parameters]] = {}
    for one in tried:
        for release in one.composition.releases.values():
            same = json.dumps([release.key, release.digest, release.values], sort_keys=True)
            found.setdefault(same, (release, one.parameters))
    return list(found.values())
