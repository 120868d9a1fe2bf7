"""The gate's checks of the release and source files that a change brings: chart, evidence, values, images, parameters.

Everything is looked up in the catalogue with its evidence assessed by the gate's own keys; nothing is taken from the
branch but the files that are judged.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.delivery.deployment.core.borders import Borders, said_as
from robotkube.delivery.deployment.core.heard_topics import heard_topics
from robotkube.delivery.deployment.core.releases import Release, Source, TaskCause
from robotkube.delivery.gate.core.check_results import CHART, IMAGES, PARAMETERS, TOPICS, VALUES, CheckLog
from robotkube.errors import InputError
from robotkube.foundation.documents.core.defaults import with_defaults
from robotkube.registry.catalogue.core.catalogue import Catalogue
from robotkube.registry.catalogue.core.chart_versions import coverage_problems, is_compared
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.charts.core.values_schemas import Validate, deployed


@dataclass(frozen=True)
class Rules:
    """The rules for one account: the namespaces that it may touch and those that belong to `others`, where charts come
    from (`oci://host/organisation`), what the catalogue knows and proves; `schema` gives the values schema of
    (chart, version), None when the catalogue has none; `images` renders a release and gives the images of its pods,
    InputError when it cannot be rendered; `last_term` is the account's highest term on main, `repair` what
    would bring a broken main back (path -> text, None removes), empty when nothing is broken. `borders` are those
    between the scopes of `accounts`, all that propose. `reserved` are the agents (and their namespaces) that main may
    enroll, `enrolled` those of them that it does."""

    account: str
    namespaces: frozenset[str]
    charts_url: str
    catalogue: Catalogue
    schema: Callable[[str, str], Mapping[str, Any] | None]
    validate: Validate
    images: Callable[[Release], Sequence[str]]
    others: frozenset[str] = frozenset()
    last_term: int = 0
    accounts: tuple[str, ...] = ()
    borders: Borders = field(default_factory=Borders)
    repair: Mapping[str, str | None] = field(default_factory=dict)
    reserved: frozenset[str] = frozenset()
    enrolled: frozenset[str] = frozenset()


def source_problems(path: str, source: Source, rules: Rules) -> Iterable[str]:
    """Problems of where a source's chart comes from."""
    if source.url != f"{rules.charts_url}/{source.chart}":
        yield f"{path}: spec.url {source.url!r} must be {rules.charts_url}/{source.chart}"


def release_problems(path: str, release: Release, rules: Rules, log: CheckLog) -> Iterable[str]:
    """Problems of a release: of chart and evidence first, since values mean nothing for a chart that may not run, and
    images last, since only valid values are rendered."""

    def tried(name: str, problems: Iterable[str]) -> Sequence[str]:
        return log.run(name, (f"{path}: {problem}" for problem in problems))

    problems = tried(CHART, _chart(release, rules))
    if not problems:
        problems = [
            *tried(VALUES, _values(release, rules)),
            *tried(TOPICS, _links(release, rules)),
            *tried(PARAMETERS, _parameters(release, rules)),
        ]
    return problems or tried(IMAGES, _images(release, rules))


def _chart(release: Release, rules: Rules) -> Iterable[str]:
    wanted = ChartReference(release.chart, release.version, release.digest)
    known = {version.reference: version for version in rules.catalogue.charts.get(release.chart, ())}
    if wanted not in known:
        has = ", ".join(sorted(str(reference) for reference in known)) or "no version of it"
        yield f"chart {wanted} is not in the catalogue, which has {has}"
        return
    obstacle = rules.catalogue.allows(known[wanted])
    if obstacle:
        yield f"chart {wanted}: {obstacle} (release policy: assurance {rules.catalogue.assurance})"
        return
    evidence = rules.catalogue.evidence_of(known[wanted])
    if release.evidence != evidence:
        yield f"robotkube.io/evidence is {release.evidence}, the evidence of chart {wanted} is {evidence}"


def _values(release: Release, rules: Rules) -> Iterable[str]:
    schema = rules.schema(release.chart, release.version)
    if schema is None:
        if rules.catalogue.assurance != "none":
            yield (
                f"the catalogue has no charts/{release.chart}/{release.version}.schema.json to check the values by; "
                "submit the chart again"
            )
        return
    yield from rules.validate(schema, deployed(schema, release.values, release.plan), "spec.values")


def _links(release: Release, rules: Rules) -> Iterable[str]:
    """Topics of other scopes' agents that it would hear without the consent of both scopes."""
    for heard in heard_topics(release.values):
        if obstacle := rules.borders.obstacle(said_as(heard.filter), release.namespace):
            yield f"spec.values.{heard.where}: {obstacle}"


def _images(release: Release, rules: Rules) -> Iterable[str]:
    """Images that its pods would run and the evidence of its chart does not cover."""
    chart = ChartReference(release.chart, release.version, release.digest)
    version = next(version for version in rules.catalogue.charts[release.chart] if version.reference == chart)
    if not is_compared(version, rules.catalogue.assurance):
        return
    try:
        images = rules.images(release)
    except InputError as error:
        yield str(error)
        return
    yield from (f"spec.values: {problem}" for problem in coverage_problems(version, images))


def _parameters(release: Release, rules: Rules) -> Iterable[str]:
    for cause in release.causes:
        yield from _parameters_of(cause, rules)


def _parameters_of(cause: TaskCause, rules: Rules) -> Iterable[str]:
    application = rules.catalogue.applications.get(cause.application)
    if application is None:
        known = ", ".join(sorted(rules.catalogue.applications)) or "none"
        yield f"task {cause.task}: the catalogue has no application {cause.application!r}; it has {known}"
        return
    if obstacle := rules.catalogue.forbids(application):
        policy = f"release policy: applications {rules.catalogue.application_assurance}"
        yield f"task {cause.task}: application {application.name}: {obstacle} ({policy})"
        return
    parameters = with_defaults(application.parameters, json.loads(cause.parameters))
    for problem in rules.validate(application.parameters, parameters, "parameters"):
        yield f"task {cause.task}: {problem}"
