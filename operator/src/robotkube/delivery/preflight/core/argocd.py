"""Argo CD: whether it is there, in which version, whether it runs, and whether managers reach its server by the scheme
of the values."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

from robotkube.delivery.preflight.core.findings import CheckVerdict, Problem, Unread
from robotkube.delivery.preflight.core.renderings import Object, labels_of, name_of
from robotkube.registry.suites.core.pod_security import items, mapping

DEFINITIONS = tuple(f"{name}.argoproj.io" for name in ("applications", "applicationsets", "appprojects"))
COMPONENT = "app.kubernetes.io/component"
PARTS = ("application-controller", "applicationset-controller", "repo-server", "server")
IMAGE_TAG = re.compile(r"[^@]*:(v?[0-9]+\.[0-9]+[^/@]*)(@.*)?")
VERSION_LABEL = "app.kubernetes.io/version"
VERSION = re.compile(r"v?([0-9]+)\.([0-9]+).*")
MAJOR = 3  # the one that the platform is tested with
SERVER = "argocd-server"
PARAMETERS = "argocd-cmd-params-cm"  # its ConfigMap; a Deployment refers to keys of it
TRUE = frozenset(["1", "t", "T", "true", "True", "TRUE"])  # what its programs take for that
PORTS = {"http": 80, "https": 443}
ADDRESS = re.compile(r"((https?)://([^/:]+)(?::([0-9]+))?)/?(.*)")  # as the chart's schema takes it
LOST = (
    "requests of managers to look again are not received: where a hook of Git is lost, or a comparison failed, a "
    "release waits until Argo CD polls"
)
CERTIFICATE = (
    "kubectl --namespace {namespace} get secret argocd-server-tls (argocd-secret where there is none) "
    "--output jsonpath='{{.data.tls\\.crt}}' | base64 --decode"
)


@dataclass(frozen=True)
class ArgoCd:
    """What is there of Argo CD: names of its definitions, its Deployments and StatefulSets, the data of its ConfigMap
    of parameters, and the ports of the Service argocd-server, None where there is no such Service."""

    namespace: str
    definitions: frozenset[str]
    workloads: Sequence[Object]
    parameters: Mapping[str, str] | Unread
    ports: frozenset[int] | Unread | None


@dataclass(frozen=True)
class ServerParameter:
    """How argocd-server is told something: by a variable or a flag, which `alone`, without a value, means that."""

    variable: str
    flag: str
    alone: str = ""


INSECURE = ServerParameter("ARGOCD_SERVER_INSECURE", "--insecure", "true")
ROOT = ServerParameter("ARGOCD_SERVER_ROOTPATH", "--rootpath")


@dataclass(frozen=True)
class ServerSpeech:
    """How argocd-server answers: by HTTPS alone, where it redirects clear text, or in clear text alone; and below which
    path. Whatever its Deployment does not let see is Unread."""

    encrypted: bool | Unread
    root: str | Unread


def argocd(present: ArgoCd, settings: Mapping[str, Any]) -> CheckVerdict:
    """The check of Argo CD: its definitions are there, its parts that carry releases out run, managers reach its
    server."""
    installed = argocd_installed(present)
    reached = _reached(present, settings)
    unseen = "; ".join(filter(None, (installed.unseen, reached.unseen)))
    said = ", ".join(filter(None, (installed.says, reached.says)))
    return CheckVerdict(said, [*installed.problems, *reached.problems], unseen)


def argocd_installed(present: ArgoCd) -> CheckVerdict:
    """The part of it about what is installed: the definitions, and the parts that carry releases out, running."""
    problems = [_undefined(name) for name in DEFINITIONS if name not in present.definitions]
    parts = {str(labels_of(workload).get(COMPONENT, "")): workload for workload in present.workloads}
    for part in PARTS:
        problems += _part(part, parts.get(part), present.namespace)
    own = [parts[part] for part in PARTS if part in parts]
    tagged, labelled = _version(_tags(own)), _version(str(labels_of(one).get(VERSION_LABEL, "")) for one in own)
    version = tagged or labelled
    unseen = "" if version or problems else f"neither a tag of its images nor a label {VERSION_LABEL} says its version"
    if version and not version.startswith(f"{MAJOR}."):
        unseen = f"the platform is tested with Argo CD {MAJOR} alone, which does not say what {version} does"
    known = f"{version or 'not known'}{f' (label {VERSION_LABEL})' if version and not tagged else ''}"
    return CheckVerdict(f"version {known} in namespace {present.namespace}", problems, unseen)


def namespace_in(settings: Mapping[str, Any]) -> str:
    """The namespace of Argo CD, as the values say."""
    return str(mapping(settings.get("argocd")).get("namespace") or "argocd")


def _undefined(name: str) -> Problem:
    why = "the chart makes such objects, and Helm refuses them"
    return Problem(
        f"there is no definition {name}", f"CustomResourceDefinition {name}", why, "install Argo CD before the platform"
    )


def _part(part: str, workload: Object | None, namespace: str) -> Iterator[Problem]:
    where = f"namespace {namespace}, {COMPONENT}={part}"
    why = "releases on main are not brought to the agents, and the Job bootstrap waits for it"
    if workload is None:
        fix = "install Argo CD there, or name its namespace in argocd.namespace"
        yield Problem(f"no Deployment or StatefulSet of {part}", where, why, fix)
    elif name_of(workload) != f"argocd-{part}":
        fix = f"install it from its own manifests, or with Helm as release argocd, so that its name is argocd-{part}"
        yield Problem(f"{part} has the name {name_of(workload)}", where, f"the platform knows it as argocd-{part}", fix)
    elif not mapping(workload.get("status")).get("readyReplicas"):
        fix = f"kubectl --namespace {namespace} get pods; kubectl describe says why one is not ready"
        yield Problem(f"no pod of {name_of(workload)} is ready", where, why, fix)


def speech(present: ArgoCd) -> ServerSpeech | None:
    """How its server answers, as its Deployment and the ConfigMap of parameters say; None without a Deployment."""
    deployment = next((one for one in present.workloads if labels_of(one).get(COMPONENT) == "server"), None)
    if deployment is None:
        return None
    template = mapping(mapping(deployment.get("spec")).get("template"))
    container = next(iter(items(mapping(template.get("spec")).get("containers"))), {})
    insecure, root = (_given(container, one, present.parameters) for one in (INSECURE, ROOT))
    return ServerSpeech(
        insecure if isinstance(insecure, Unread) else insecure not in TRUE,
        root if isinstance(root, Unread) else root.strip("/"),
    )


def server_of(present: ArgoCd, settings: Mapping[str, Any]) -> str:
    """The address that managers ask, as the chart makes it of the values."""
    server = mapping(mapping(settings.get("argocd")).get("server"))
    domain = settings.get("clusterDomain") or "cluster.local"
    service = f"{SERVER}.{present.namespace}.svc.{domain}"
    return str(server.get("url") or f"{'https' if server.get('authorities') else 'http'}://{service}")


def _given(container: Object, parameter: ServerParameter, data: Mapping[str, str] | Unread) -> str | Unread:
    """What a container is given by the flag, else by the variable, in which a key of PARAMETERS may stand."""
    words = [str(word) for key in ("command", "args") for word in container.get(key) or ()]
    for word, following in zip_longest(words, words[1:], fillvalue=""):
        name, equals, value = word.partition("=")
        if name == parameter.flag:
            return value if equals else parameter.alone or following
    entry = next((one for one in items(container.get("env")) if one.get("name") == parameter.variable), None)
    if entry is None:
        return Unread(f"{parameter.variable} may come by envFrom") if container.get("envFrom") else ""
    reference = mapping(mapping(entry.get("valueFrom")).get("configMapKeyRef"))
    if not reference and "valueFrom" not in entry:
        return str(entry.get("value") or "")
    if reference.get("name") != PARAMETERS:
        return Unread(f"{parameter.variable} does not come from ConfigMap {PARAMETERS}")
    return data if isinstance(data, Unread) else data.get(str(reference.get("key")), "")


def _reached(present: ArgoCd, settings: Mapping[str, Any]) -> CheckVerdict:
    """Whether the address of the values is that of its Service, and its server answers there as it is asked."""
    spoken = speech(present)
    if spoken is None:
        return CheckVerdict("")
    url = server_of(present, settings)
    address = ADDRESS.fullmatch(url)
    domain = settings.get("clusterDomain") or "cluster.local"
    service = f"{SERVER}.{present.namespace}"
    if address is None or address[3] not in (service, f"{service}.svc", f"{service}.svc.{domain}"):
        return CheckVerdict("", unseen=f"whether managers reach {url} (argocd.server.url) is not tried from here")
    problems = [*_ports(present, int(address[4] or PORTS[address[2]])), *_scheme(present, spoken, url)]
    unseen = [fact.why for fact in (present.ports, spoken.encrypted, spoken.root) if isinstance(fact, Unread)]
    if isinstance(spoken.root, str) and spoken.root != address[5].strip("/"):
        problems.append(_elsewhere(present, f"{address[1]}/{spoken.root}".rstrip("/"), url))
    words = f"how {SERVER} answers is not known: {'; '.join(dict.fromkeys(unseen))}" if unseen else ""
    return CheckVerdict("" if problems or unseen else f"asked by {address[2].upper()}", problems, words)


def _ports(present: ArgoCd, wanted: int) -> Iterator[Problem]:
    where = f"Service {present.namespace}/{SERVER}"
    fix = f"install Argo CD's own Service {SERVER}, or name the address that answers in argocd.server.url"
    if present.ports is None:
        yield Problem(f"there is no Service {SERVER}", where, LOST, fix)
    elif not isinstance(present.ports, Unread) and wanted not in present.ports:
        yield Problem(f"it has no port {wanted}, at which managers ask", where, LOST, fix)


def _scheme(present: ArgoCd, spoken: ServerSpeech, url: str) -> Iterator[Problem]:
    where = f"Deployment {present.namespace}/{SERVER}"
    asked = url.startswith("https://")
    if isinstance(spoken.encrypted, Unread) or spoken.encrypted == asked:
        return
    if spoken.encrypted:
        what = f"it redirects to HTTPS, and managers ask {url}"
        shown = CERTIFICATE.format(namespace=present.namespace)
        fix = (
            f"argocd.server.authorities: the certificate that it shows ({shown}); or "
            f'server.insecure: "true" in ConfigMap {PARAMETERS}, and kubectl rollout restart'
        )
    else:
        what = f"it speaks no TLS (server.insecure), and managers ask {url}"
        fix = "leave argocd.server.authorities and url empty, or take server.insecure away and restart it"
    yield Problem(what, where, LOST, fix)


def _elsewhere(present: ArgoCd, there: str, url: str) -> Problem:
    return Problem(
        f"its API is below {there} (server.rootpath), and managers ask {url}",
        f"Deployment {present.namespace}/{SERVER}",
        LOST,
        f"argocd.server.url: {there}",
    )


def _tags(workloads: Sequence[Object]) -> Iterator[str]:
    """The tags of the workloads' images."""
    for workload in workloads:
        template = mapping(mapping(workload.get("spec")).get("template"))
        for container in items(mapping(template.get("spec")).get("containers")):
            match = IMAGE_TAG.fullmatch(str(container.get("image", "")))
            yield match[1] if match else ""


def _version(texts: Iterable[str]) -> str:
    """The first two numbers of the first text that is a version; empty when none is."""
    match = next(filter(None, map(VERSION.fullmatch, texts)), None)
    return f"{match[1]}.{match[2]}" if match else ""
