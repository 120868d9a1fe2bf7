"""Policies for Argo CD's Applications and projects: what its application controller may be told to apply."""

from __future__ import annotations

from robotkube.registry.admission.core.documents import Place, Policy, Validation
from robotkube.registry.admission.core.domain import PROJECT, Domain
from robotkube.registry.admission.core.expressions import CREATING, WRITER, one_of, sentence
from robotkube.registry.admission.core.lists import Lookup, texts

SERVER = "https://kubernetes.default.svc"
PLAN = "global.plan"
SPEC_KEYS = ("destination", "project", "revisionHistoryLimit", "source", "syncPolicy")
SOURCE_KEYS = ("helm", "path", "repoURL", "targetRevision")
HELM_KEYS = ("parameters", "releaseName", "values")
DESTINATION_KEYS = ("namespace", "server")
SYNC_KEYS = ("automated", "retry", "syncOptions")
NAME = "object.metadata.name"
NONE = "orValue('(none)')"


def policy(domain: Domain, charts: Lookup) -> Policy:
    """Of Applications. Their definition has no status subresource, so status, operations and finalizers arrive as
    updates too: the spec is judged when it changes, and so is the operation. One that stands there was judged when it
    came: while it is carried out, a commit may give the Application its next source."""
    chart = (
        f"variables.source.?repoURL.orValue('').startsWith('{domain.charts}/') ? "
        f"[variables.source.repoURL.substring('{domain.charts}/'.size()) + '@' + "
        "variables.source.?targetRevision.orValue('')] : ['']"
    )
    variables = [
        {"name": "source", "expression": "object.spec.?source.orValue({})"},
        {"name": "chart", "expression": chart},
        *charts.without("unlisted", "chart", image=False),
        {"name": "helm", "expression": "variables.source.?helm.orValue({})"},
        {"name": "sync", "expression": "object.?operation.?sync.orValue({})"},
    ]
    rules = [_writer(domain), _project(), _destination(domain), _one_chart(), _verified(domain), _operation()]
    kinds = [("argoproj.io", ["applications"])]
    return Policy("robotkube-applications", kinds, None, variables, rules, charts.parameters)


def projects(domain: Domain) -> Policy:
    """Of the project that releases are in: Argo CD's own accounts do not widen it."""
    own = f"'system:serviceaccounts:{domain.argocd}' in request.userInfo.groups"
    why = ": who installs the platform says what releases may be made of. Change the values of charts/robotkube"
    rule = Validation(
        f"{NAME} != '{PROJECT}' || {_when_specified(f'!({own})')}",
        sentence(f"AppProject {PROJECT} changed by ", WRITER, why),
    )
    place = Place((domain.argocd,))
    return Policy("robotkube-projects", [("argoproj.io", ["appprojects"])], place, [], [rule])


def _writer(domain: Domain) -> Validation:
    return Validation(
        _when_specified(one_of((domain.generator, domain.application_controller))),
        sentence(
            "Application ",
            NAME,
            " written by ",
            WRITER,
            ": Argo CD's ApplicationSet controller alone writes them, from main. Propose a release instead",
        ),
    )


def _project() -> Validation:
    why = f", not in {PROJECT}, the one that limits releases. Set spec.project to {PROJECT}"
    return Validation(
        _when_specified(f"object.spec.project == '{PROJECT}'"),
        sentence("Application ", NAME, " is in project ", "object.spec.project", why),
    )


def _destination(domain: Domain) -> Validation:
    place = "object.spec.destination"
    holds = (
        f"{_only(place, DESTINATION_KEYS)} && {place}.?server.orValue('') == '{SERVER}' && "
        f"{place}.?namespace.orValue('') in {texts(domain.agents)}"
    )
    return Validation(
        _when_specified(holds),
        sentence(
            "Application ",
            NAME,
            " goes to namespace ",
            f"{place}.?namespace.{NONE}",
            " of ",
            f"{place}.?server.{NONE}",
            ", but releases run in agents' namespaces of this cluster alone. Correct metadata.namespace of the release",
        ),
    )


def _one_chart() -> Validation:
    holds = (
        f"has(object.spec.source) && {_only('object.spec', SPEC_KEYS)} && {_only('variables.source', SOURCE_KEYS)} && "
        f"variables.source.?path.orValue('') == '.' && {_only('variables.helm', HELM_KEYS)} && "
        f"{_only('object.spec.?syncPolicy.orValue({})', SYNC_KEYS)} && "
        f"variables.helm.?parameters.orValue([]).all(p, p.?name.orValue('') == '{PLAN}')"
    )
    why = (
        " is more than one chart with its values: it has several sources, a key that releases do not use, or a "
        f"parameter besides {PLAN}, which nobody checked. Say it in the release's values"
    )
    return Validation(_when_specified(holds), sentence("Application ", NAME, why))


def _verified(domain: Domain) -> Validation:
    why = (
        f": only charts of {domain.charts} that are verified on the catalogue's main are applied, by digest. Submit "
        "the chart (robotkube registry submit), or correct robotkube.io/chart and robotkube.io/chart-digest of the "
        "release"
    )
    source = "variables.source.?repoURL"
    revision = "variables.source.?targetRevision"
    return Validation(
        _when_specified("variables.unlisted.size() == 0"),
        sentence("Application ", NAME, " is of ", f"{source}.{NONE}", " at ", f"{revision}.{NONE}", why),
    )


def _operation() -> Validation:
    """An operation can carry a source of its own, which neither the spec nor the project's sources see."""
    holds = (
        "!has(variables.sync.sources) && !has(variables.sync.manifests) && !has(variables.sync.revisions) && "
        "(!has(variables.sync.source) || variables.sync.source == variables.source) && "
        "(variables.sync.?revision.orValue('') == '' || variables.sync.revision == variables.source.targetRevision)"
    )
    why = (
        ": operation.sync names another source or revision than the Application, or manifests of its own, and would "
        "apply what main does not say. Ask for a sync without them"
    )
    changed = f"{CREATING} || object.?operation != oldObject.?operation"
    return Validation(f"!({changed}) || ({holds})", sentence("Application ", NAME, why))


def _when_specified(holds: str) -> str:
    return f"!({CREATING} || object.spec != oldObject.spec) || ({holds})"


def _only(value: str, keys: tuple[str, ...]) -> str:
    return f"{value}.all(k, k in {texts(keys)})"
