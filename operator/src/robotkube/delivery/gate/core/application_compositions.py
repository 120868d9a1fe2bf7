"""Compositions of one application for samples of its parameters, by the code that the manager composes with.

What no sample of an application can be composed for, no task for it would ever be met: its author learns that from
`registry validate` and from the gate's trial, in the same words. A sample proves nothing of the parameters that it
leaves out.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.gate.core.application_samples import (
    Parameters,
    demand,
    inventory,
    sampled_parameters,
    ways,
    with_subject,
)
from robotkube.delivery.manager.core.composition.composer import Composition, Inputs, Refused, compose
from robotkube.delivery.manager.core.composition.inputs import Schema
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.registry.catalogue.core.applications import Application
from robotkube.registry.catalogue.core.catalogue import Catalogue, Pin
from robotkube.registry.catalogue.core.versions import version_key
from robotkube.registry.charts.core.values_schemas import Validate

OLDER_VERSIONS = 3  # of a chart, that are tried besides the one that is selected
OLDER_SAMPLES = 3
PARAMETERS_SHOWN_MAX = 200
PROBLEMS_MAX = 20
WRONG = frozenset(
    {
        "CompositionFailed",
        "NoVerifiedVersion",
        "GuaranteeNotMet",
        "UnknownApplication",
        "LinkTypeUnknown",
        "LinkMismatch",
        "LinkNotPermitted",
    }
)
"""Refusals that the application is to blame for; others say that the sampled fleet cannot serve a sample."""
NOT_SELECTED = frozenset({"NoVerifiedVersion", "GuaranteeNotMet"})

Problem = tuple[str, str]
"""Key in the application's document, text."""


@dataclass(frozen=True)
class Tried:
    """One composition: the parameters, and what came out."""

    parameters: Parameters
    composition: Composition

    @property
    def refused(self) -> Refused | None:
        """Why the demand for the application is not met; None when it is."""
        outcome = next(iter(self.composition.outcomes.values()))
        return outcome if isinstance(outcome, Refused) else None


class ApplicationCompositions:
    """The compositions of the application `name`; `schema`, `render` and `validate` are as composition takes them.
    What is found is in `problems`, the same of other samples only once."""

    def __init__(self, name: str, catalogue: Catalogue, schema: Schema, render: Render, validate: Validate) -> None:
        self.application: Application = catalogue.applications[name]
        self.catalogue, self._subject = with_subject(catalogue, name)
        self._schema = schema
        self._render = render
        self._validate = validate
        self._problems: dict[tuple[str, ...], Problem] = {}

    @property
    def problems(self) -> Sequence[Problem]:
        """What was found so far, the first of it."""
        return tuple(self._problems.values())[:PROBLEMS_MAX]

    def report(self, about: tuple[str, ...], key: str, text: str, parameters: Parameters) -> None:
        """Report a problem; the same one of other samples only once."""
        shown = f"{dict(parameters)!r:.{PARAMETERS_SHOWN_MAX}}"  # first: what shows reports may cut long ones
        self._problems.setdefault(about, (key, f"with parameters {shown}: {text}"))

    def samples(self) -> Sequence[Parameters]:
        """Sets of parameters that the schema accepts; that there are none is a problem."""
        samples = sampled_parameters(self._subject, self._validate)
        if not samples:
            text = "no set of values was found that the schema accepts; add `examples: [...]` to the parameters"
            self._problems["samples",] = ("spec.parameters", text)
        return samples

    def composed(self, samples: Sequence[Parameters], late: Callable[[], bool]) -> Sequence[Tried] | None:
        """The compositions of the samples in every way in which the application may be asked for, and, for the first of
        them, with older versions of its charts; None when it got `late`."""
        by_way = {way: [self._composed(way, sample) for sample in samples if not late()] for way in ways(self._subject)}
        if late():
            return None
        way = min(by_way, key=lambda one: (len(_wrong(by_way[one])), -len(_met(by_way[one]))))
        self._report_refusals(by_way[way])
        tried = [composition for compositions in by_way.values() for composition in compositions]
        return [*tried, *self._with_older_versions(way, samples[:OLDER_SAMPLES], tried)]

    def _composed(self, way: str, parameters: Parameters, withheld: Mapping[Pin, str] | None = None) -> Tried:
        """The composition of the one demand for the application with these parameters."""
        fleet = inventory(self._subject, parameters, self._render)
        inputs = Inputs(
            *(self.catalogue, fleet, {}, self._render, self._validate), withheld=withheld or {}, schema=self._schema
        )
        return Tried(parameters, compose([demand(self._subject, parameters, way)], inputs))

    def _report_refusals(self, tried: Sequence[Tried]) -> None:
        for one in _wrong(tried):
            assert one.refused is not None
            self.report((one.refused.reason, one.refused.message), "spec", one.refused.message, one.parameters)
        if not self._problems and not _met(tried):
            refused = tried[0].refused
            words = f"{refused.reason}: {refused.message}" if refused else ""
            fix = "give the parameters `examples` that name agents, or widen the placements"
            self.report(("nothing",), "spec", f"no sample could be composed: {words}; {fix}", tried[0].parameters)

    def _with_older_versions(self, way: str, samples: Sequence[Parameters], tried: Sequence[Tried]) -> Sequence[Tried]:
        """Compositions with versions that would be selected if newer ones were withdrawn, or that releases keep."""
        older = []
        for chart, withheld in self._older_versions(releases(tried)):
            composed = [self._composed(way, sample, withheld) for sample in samples]
            served = [one for one in composed if one.refused is None or one.refused.reason not in NOT_SELECTED]
            for one in _wrong(served):
                assert one.refused is not None
                fix = f"narrow the range of chart {chart}"
                self.report((one.refused.message,), "spec", f"{one.refused.message}; {fix}", one.parameters)
            older += served
        return older

    def _older_versions(self, made: Sequence[tuple[Release, Parameters]]) -> Iterator[tuple[str, Mapping[Pin, str]]]:
        """Allowed versions beside those that were selected: of each its chart, and what is withheld to select it."""
        selected = {(release.chart, release.version) for release, _ in made}
        for chart in sorted({chart for chart, _ in selected}):
            versions = self.catalogue.charts[chart]
            others = [v for v in versions if not self.catalogue.allows(v) and (chart, v.version) not in selected]
            others.sort(key=lambda version: version_key(version.version), reverse=True)
            for version in others[:OLDER_VERSIONS]:
                yield chart, {(chart, v.version): "another one is tried" for v in versions if v is not version}


def releases(tried: Sequence[Tried]) -> Sequence[tuple[Release, Parameters]]:
    """Every different release, with the first parameters that gave it."""
    first_of_each: dict[str, tuple[Release, Parameters]] = {}
    for one in tried:
        for release in one.composition.releases.values():
            same = json.dumps([release.key, release.digest, release.values], sort_keys=True)
            first_of_each.setdefault(same, (release, one.parameters))
    return list(first_of_each.values())


def _wrong(tried: Sequence[Tried]) -> Sequence[Tried]:
    """The compositions that failed for a reason that the application is to blame for."""
    return [one for one in tried if one.refused is not None and one.refused.reason in WRONG]


def _met(tried: Sequence[Tried]) -> Sequence[Tried]:
    return [one for one in tried if one.refused is None]
