"""Policies for workloads and for Argo CD's objects, as documents of the API: the same rules in files of the API server
and as ordinary objects, which differ in where the list stands.

    robotkube-agents        images of verified charts; workloads by Argo CD's application controller alone
    robotkube-tests         any image by digest; workloads by the suite-runner alone
    robotkube-platform      images of the platform; pods by controllers alone
    robotkube-elsewhere     images of either list, in all other namespaces (where the whole cluster is ours)
    robotkube-applications  what Argo CD may be told to apply
    robotkube-projects      what releases may be made of
    robotkube-subresources  what comes by status, bindings and resizing
    robotkube-nodes         whose machine a Node is
    robotkube-registrations what changes, refuses or answers requests (where the whole cluster is ours)
    robotkube-volumes       which folders of machines are volumes (where the provider says)

Nothing of any of these namespaces gets a way to its machine: what stands there could be changed from it, these files
among it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.registry.admission.core import applications, nodes, registrations, subresources, volumes
from robotkube.registry.admission.core.allowed import Allowed
from robotkube.registry.admission.core.documents import Place, Policy, Validation
from robotkube.registry.admission.core.domain import KEEPERS, POD_MAKERS, Domain, controllers
from robotkube.registry.admission.core.expressions import (
    CREATING,
    EPHEMERAL,
    RESOURCE,
    RESOURCES,
    WRITER,
    changed,
    image_variables,
    on_host,
    one_of,
    only_taken_away,
    sentence,
)
from robotkube.registry.admission.core.lists import Literals, Lookup, Parameters, parameter_keys, texts

FILE_SUFFIX = ".static.k8s.io"
API_POLICIES = tuple(
    f"robotkube-{name}" for name in ("agents", "tests", "subresources", "platform", "applications", "projects", "nodes")
)
LIST = "admission-list"
PLATFORM_LIST = "admission-platform"
DIGEST_FORM = "^[^@]+@sha256:[0-9a-f]{64}$"
PODS = controllers(*POD_MAKERS)
KEPT = ("spec", "template", "metadata.labels", "metadata.annotations")
NOT_VERIFIED = (
    "only images of chart versions that are verified on the catalogue's main run in an agent's namespace, by digest. "
    "Submit the chart that needs it (robotkube registry submit), or name the digest that was verified"
)
NOT_BY_DIGEST = (
    "a tag can be moved after it was checked, a digest cannot. Write <repository>@sha256:<digest> in the chart"
)
NOT_OF_THE_PLATFORM = (
    "only images that the platform was installed with run in its namespaces, by digest. Install the platform with it, "
    "or run it in a chart"
)
NOT_KNOWN = (
    "only images of the platform and of verified charts run in this cluster, by digest. Submit the chart that needs "
    "it (robotkube registry submit), or start the cluster with it"
)


@dataclass(frozen=True)
class _Lookups:
    """The lists as the policies ask for them: of the agents' images, of the platform's, of both, and of charts."""

    verified: Lookup
    platform: Lookup
    both: Lookup
    charts: Lookup


def for_files(domain: Domain, allowed: Allowed) -> list[dict[str, Any]]:
    """Policies and bindings for the API server's folder of manifests, with the list in them."""
    both = tuple(sorted({*allowed.verified, *allowed.platform}))
    lookups = _Lookups(*map(Literals, (allowed.verified, allowed.platform, both, allowed.charts)))
    return [part for policy in _policies(domain, lookups) for part in policy.documents(FILE_SUFFIX, domain.platform)]


def for_api(domain: Domain) -> list[dict[str, Any]]:
    """Policies and bindings as ordinary objects. What releases may be of stands in the ConfigMap LIST of the platform's
    namespace (`list_entries`), the platform's images in PLATFORM_LIST (`platform_entries`); what asks for a ConfigMap
    that is not there is refused. Other namespaces of the cluster are not judged."""
    images = Parameters(PLATFORM_LIST, "platform")
    lookups = _Lookups(Parameters(LIST, "image"), images, images, Parameters(LIST, "chart"))
    return [part for policy in _policies(domain, lookups) for part in policy.documents("", domain.platform)]


def list_entries(charts: Iterable[str], verified: Iterable[str]) -> dict[str, str]:
    """The data of the ConfigMap LIST."""
    return {**parameter_keys("image", verified), **parameter_keys("chart", charts)}


def platform_entries(platform: Iterable[str]) -> dict[str, str]:
    """The data of the ConfigMap PLATFORM_LIST."""
    return parameter_keys("platform", platform)


def _policies(domain: Domain, lookups: _Lookups) -> Iterator[Policy]:
    if domain.agents:
        yield _agents(domain, lookups.verified)
    if domain.tests:
        yield _tests(domain)
    if domain.agents or domain.tests:
        yield subresources.policy(domain)
    yield _platform(domain, lookups.platform)
    if domain.elsewhere:
        yield _elsewhere(domain, lookups.both)
    yield applications.policy(domain, lookups.charts)
    yield applications.projects(domain)
    yield nodes.policy()
    if domain.elsewhere:
        yield registrations.policy()
    if domain.volumes:
        yield volumes.policy(domain.volumes)


def _agents(domain: Domain, lookup: Lookup) -> Policy:
    writer = domain.application_controller
    rules = [
        _images(NOT_VERIFIED),
        _no_debugging(),
        _made(
            _makers(writer),
            ": in an agent's namespace Argo CD's application controller alone makes workloads, and controllers make "
            "their pods, so that what runs is what main says. Ask for it by a task (robotkube task submit), or "
            "propose a release",
        ),
        _kept(
            writer,
            ": in an agent's namespace nothing runs but what main says. Change the release on main",
            _taken_away(domain.remover_account),
        ),
    ]
    return _workloads("agents", Place(domain.agents), _strange(lookup), rules, lookup.parameters)


def _tests(domain: Domain) -> Policy:
    """Wider: what is tried there is not verified yet, so any image may run, and the suite-runner makes pods itself."""
    writer = domain.suite_runner
    rules = [
        _images(NOT_BY_DIGEST),
        _no_debugging(),
        _made(
            {**_makers(writer), "pods": (*PODS, writer)},
            ": in a test namespace the suite-runner alone starts what is tried. Submit the chart "
            "(robotkube registry submit)",
        ),
        _kept(writer, ": in a test namespace runs what was submitted. Change the chart, and submit it again"),
    ]
    strange = {"name": "strange", "expression": f"variables.images.filter(i, !i.matches('{DIGEST_FORM}'))"}
    return _workloads("tests", Place(domain.tests), [strange], rules)


def _platform(domain: Domain, lookup: Lookup) -> Policy:
    pods = Validation(
        f"!({CREATING}) || {RESOURCE} != 'pods' || {one_of(PODS)}",
        sentence(
            "pod made by ",
            WRITER,
            ": in the platform's namespaces controllers alone make pods. Change the values of the chart",
        ),
    )
    return _workloads(
        "platform",
        Place(domain.of_the_platform),
        _strange(lookup),
        [_images(NOT_OF_THE_PLATFORM), pods],
        lookup.parameters,
    )


def _elsewhere(domain: Domain, lookup: Lookup) -> Policy:
    place = Place((*domain.agents, *domain.tests, domain.platform, domain.gate, domain.argocd), others=True)
    return _workloads("elsewhere", place, _strange(lookup), [_images(NOT_KNOWN)], lookup.parameters)


def _strange(lookup: Lookup) -> Sequence[Mapping[str, str]]:
    return lookup.without("strange", "images", image=True)


def _makers(writer: str) -> Mapping[str, Sequence[str]]:
    """Who makes what: `writer` what stands at the top, and of what follows from it the controller that it is for."""
    kinds = [kind for _, resources in RESOURCES for kind in resources if "/" not in kind]
    return {
        **dict.fromkeys(kinds, (writer,)),
        "jobs": (writer, *controllers("cronjob-controller")),
        "replicasets": controllers("deployment-controller"),
        "pods": PODS,
    }


def _made(makers: Mapping[str, Sequence[str]], why: str) -> Validation:
    names = ",".join(f"'{kind}':{texts(accounts)}" for kind, accounts in sorted(makers.items()))
    return Validation(
        f"!({CREATING}) || {WRITER} in {{{names}}}[{RESOURCE}]", sentence("", RESOURCE, " made by ", WRITER, why)
    )


def _kept(writer: str, why: str, *exceptions: str) -> Validation:
    """Who changes what matters of an object that is there; `exceptions` are changes that may be as well."""
    writers = one_of((writer, *controllers(*KEEPERS)))
    return Validation(
        " || ".join([CREATING, EPHEMERAL, writers, f"!({changed(KEPT)})", *exceptions]),
        sentence("", RESOURCE, " ", "request.name", " changed by ", WRITER, why),
    )


def _taken_away(remover: str) -> str:
    """The remover takes away what no chart renders, of the one kind of workload that releases have."""
    return f"{WRITER} == '{remover}' && {RESOURCE} == 'deployments' && {only_taken_away()}"


def _images(why: str) -> Validation:
    first = "(variables.unlisted[0] == '' ? '(none)' : variables.unlisted[0])"
    return Validation(
        "variables.unlisted.size() == 0",
        sentence("image ", first, " may not run in namespace ", "request.namespace", f": {why}"),
    )


def _no_debugging() -> Validation:
    return Validation(
        f"!({EPHEMERAL})",
        sentence(
            "no container may be added to a pod that runs in namespace ",
            "request.namespace",
            ": nobody verified the pod with it. Read the pod's logs, or try the chart with that container in a suite",
        ),
    )


def _no_host() -> Validation:
    """The rule about volumes of a machine's files, from which there is a way to everything that runs on it."""
    return Validation(
        f"variables.pod == variables.before || !({on_host()})",
        sentence(
            "",
            RESOURCE,
            " in namespace ",
            "request.namespace",
            " ask for a way to their machine (its network, processes, files, or privileges): nothing on this platform "
            "needs one. Use a volume claim, a Service, or no privileges",
        ),
    )


def _workloads(
    name: str,
    place: Place,
    strange: Iterable[Mapping[str, str]],
    rules: Sequence[Validation],
    parameters: str = "",
) -> Policy:
    """The validations of workloads. `strange`: variables of which the last has the images that are not listed. Those
    that an update adds count; the list is asked first, since most are listed."""
    unlisted = {"name": "unlisted", "expression": "variables.strange.filter(i, !(i in variables.known))"}
    variables = [*image_variables(), *strange, unlisted]
    return Policy(f"robotkube-{name}", RESOURCES, place, variables, [*rules, _no_host()], parameters)
