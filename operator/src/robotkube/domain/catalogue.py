"""The catalogue as values: applications, chart versions, the release policy; reading them, selecting a version.

    applications/<name>.yaml            what can be asked for
    charts/<chart>/<version>.yaml       what exists, in which state, by which digest
    policies/release.yaml               which states may be deployed

A file that breaks its rules makes that one entry unusable and is named in `Catalogue.problems`; the others stay.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from robotkube.domain.documents import Reader
from robotkube.domain.errors import DocumentError, RefusalError
from robotkube.domain.proposals import ChartReference
from robotkube.domain.releases import DIGEST, FILES_KEPT_MAX, NAME, VERSION
from robotkube.domain.texts import read_mapping

API = "registry.robotkube.io/v1alpha1"
FOLDERS = ("applications", "charts", "policies")
LINK_KINDS = ("mqtt",)
STATES = ("staged", "verified", "withdrawn")
ASSURANCES: Mapping[str, frozenset[str]] = {
    "none": frozenset({"staged", "verified"}),
    "verified": frozenset({"verified"}),
}

_VARIABLE = re.compile(r"[a-z][a-z0-9_]*", re.ASCII)
_PROVIDES = re.compile(r"[a-z0-9-]+(/[a-z0-9-]+)*", re.ASCII)
_COMPARATOR = re.compile(r"(>=|<=|>|<|=)(\d+\.\d+\.\d+(?:-[0-9A-Za-z.-]+)?)", re.ASCII)
_LINK_END = ("agent", "role", "service")
_RESERVED = frozenset({"parameters", "agent", "task", "placement", "topics"})


@dataclass(frozen=True)
class ChartRequirement:
    """A chart by name and range: comparators separated by spaces, all must hold (`>=0.1.0 <0.2.0`)."""

    name: str
    version: str


@dataclass(frozen=True)
class PlacementRule:
    """Where a service may run: on the named agent (a template), or on one agent of a role that has all capabilities."""

    agent: str = ""
    role: str = ""
    capabilities: tuple[str, ...] = ()


@dataclass(frozen=True)
class Service:
    """One microservice of an application; `release` and `values` are templates, `for_each` is variable -> list."""

    name: str
    release: str
    chart: ChartRequirement
    placement: PlacementRule
    values: Mapping[str, Any]
    for_each: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Link:
    """Topics that go from one end to another; an end is {agent: template} | {role: name} | {service: name}."""

    kind: str
    source: Mapping[str, str]
    target: Mapping[str, str]
    topics: tuple[Mapping[str, Any], ...]
    for_each: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Application:
    """What the catalogue offers. `parameters` is a JSON Schema; `initial_for` a role or empty; an application that
    provides `link/<kind>` gives the bridge service that composition puts at both ends of links of that kind."""

    name: str
    description: str
    provides: tuple[str, ...]
    parameters: Mapping[str, Any]
    services: tuple[Service, ...]
    links: tuple[Link, ...] = ()
    initial_for: str = ""

    @property
    def area(self) -> str:
        """The word in commit subjects: the first part of what it provides first, else its name."""
        return self.provides[0].partition("/")[0] if self.provides else self.name


@dataclass(frozen=True)
class ChartVersion:
    """One published version of a chart; `digest` is the OCI manifest digest."""

    chart: str
    version: str
    state: str
    digest: str

    @property
    def reference(self) -> ChartReference:
        """As trailers name it."""
        return ChartReference(self.chart, self.version, self.digest)


@dataclass(frozen=True)
class Catalogue:
    """Everything that can be selected, at one commit of the catalogue repository."""

    applications: Mapping[str, Application] = field(default_factory=dict)
    charts: Mapping[str, tuple[ChartVersion, ...]] = field(default_factory=dict)
    assurance: str = "verified"
    problems: tuple[str, ...] = ()

    def bridge(self, kind: str) -> Application:
        """The application whose service bridges links of that kind; RefusalError when there is not exactly one."""
        found = [a for a in self.applications.values() if f"link/{kind}" in a.provides]
        if len(found) != 1:
            names = ", ".join(sorted(a.name for a in found)) or "none does"
            raise RefusalError("CompositionFailed", f"exactly one application must provide link/{kind}; {names}")
        return found[0]

    def select(self, requirement: ChartRequirement) -> tuple[ChartVersion, tuple[str, ...]]:
        """The highest version in the range whose state the policy allows, and why each candidate was taken or not.

        RefusalError(NoVerifiedVersion) when none is left."""
        reasons: list[str] = []
        chosen: ChartVersion | None = None
        allowed = ASSURANCES[self.assurance]
        versions = sorted(self.charts.get(requirement.name, ()), key=lambda c: version_key(c.version), reverse=True)
        for candidate in versions:
            verdict = _verdict(candidate, requirement, allowed, chosen)
            reasons.append(f"{candidate.chart} {candidate.version} ({candidate.state}): {verdict}")
            if verdict == "taken":
                chosen = candidate
        if chosen is None:
            detail = "; ".join(reasons) or "the catalogue has no version of it"
            wanted = f"chart {requirement.name} {requirement.version} with assurance {self.assurance}"
            raise RefusalError("NoVerifiedVersion", f"no version of {wanted}: {detail}")
        return chosen, tuple(reasons)


def _verdict(
    candidate: ChartVersion, requirement: ChartRequirement, allowed: frozenset[str], chosen: ChartVersion | None
) -> str:
    if candidate.state not in allowed:
        return f"state {candidate.state} is not allowed"
    if not in_range(candidate.version, requirement.version):
        return f"not in {requirement.version}"
    return "taken" if chosen is None else f"older than {chosen.version}"


def version_key(version: str) -> tuple[int, int, int, bool, str]:
    """Sorts versions; a pre-release comes before its release."""
    core, _, pre = version.partition("-")
    major, minor, patch = (int(part) for part in core.split("."))
    return major, minor, patch, not pre, pre


def in_range(version: str, requirement: str) -> bool:
    """Whether every comparator of `requirement` holds (`requirement` was checked when it was read)."""
    key = version_key(version)
    for comparator in requirement.split():
        match = _COMPARATOR.fullmatch(comparator)
        if match is None:
            return False
        bound = version_key(match[2])
        holds = {">=": key >= bound, "<=": key <= bound, ">": key > bound, "<": key < bound, "=": key == bound}
        if not holds[match[1]]:
            return False
    return True


def read_catalogue(files: Mapping[str, str]) -> Catalogue:
    """The catalogue in `files` (path -> text); unusable files become problems."""
    applications: dict[str, Application] = {}
    charts: dict[str, list[ChartVersion]] = {}
    assurance, problems = "verified", []
    for path in sorted(files):
        parts = path.removesuffix(".yaml").split("/")
        try:
            if parts[0] == "applications" and len(parts) == 2:
                applications[parts[1]] = read_application(files[path], path)
            elif parts[0] == "charts" and len(parts) == 3:
                charts.setdefault(parts[1], []).append(read_chart_version(files[path], path))
            elif path == "policies/release.yaml":
                assurance = read_assurance(files[path], path)
        except DocumentError as error:
            problems += [f"{error.where}: {problem}" for problem in error.problems]
    return Catalogue(applications, {name: tuple(v) for name, v in charts.items()}, assurance, tuple(problems))


def read_assurance(text: str, path: str) -> str:
    """The release policy: `assurance: none | verified`."""
    reader = Reader(path)
    document = reader.mapping(read_mapping(text, path), "", ["assurance"])
    if document.get("assurance") not in ASSURANCES:
        reader.problems.append(f"assurance: must be one of {', '.join(ASSURANCES)}")
    reader.finish()
    return str(document["assurance"])


@lru_cache(FILES_KEPT_MAX)
def read_chart_version(text: str, path: str) -> ChartVersion:
    """A published chart version; its path says chart and version, its status state and digest."""
    reader = Reader(path)
    document = reader.mapping(read_mapping(text, path), "", ["apiVersion", "kind", "metadata", "spec", "status"])
    reader.equal(document.get("apiVersion"), "apiVersion", API)
    reader.equal(document.get("kind"), "kind", "ChartVersion")
    metadata = reader.mapping(document.get("metadata") or {}, "metadata", ["name"])
    spec = document.get("spec") if isinstance(document.get("spec"), Mapping) else {}
    assert isinstance(spec, Mapping)
    status = reader.mapping(document.get("status") or {}, "status", ["state", "digest"], ["images", "evidence"])
    chart = reader.word(metadata.get("name"), "metadata.name", NAME)
    version = reader.word(spec.get("version"), "spec.version", VERSION)
    reader.equal(path, "path", f"charts/{chart}/{version}.yaml")
    if status.get("state") not in STATES:
        reader.problems.append(f"status.state: must be one of {', '.join(STATES)}")
    digest = reader.text(status.get("digest"), "status.digest", DIGEST)
    reader.finish()
    return ChartVersion(chart, version, str(status["state"]), digest)


@lru_cache(FILES_KEPT_MAX)
def read_application(text: str, path: str) -> Application:
    """An application of the catalogue; its name is the file's name."""
    reader = Reader(path)
    document = reader.mapping(read_mapping(text, path), "", ["apiVersion", "kind", "metadata", "spec"])
    reader.equal(document.get("apiVersion"), "apiVersion", API)
    reader.equal(document.get("kind"), "kind", "Application")
    metadata = reader.mapping(document.get("metadata") or {}, "metadata", ["name"])
    spec = reader.mapping(
        document.get("spec") or {},
        "spec",
        ["description", "provides", "parameters"],
        ["initialFor", "services", "links"],
    )
    name = reader.word(metadata.get("name"), "metadata.name", NAME)
    reader.equal(path, "path", f"applications/{name}.yaml")
    parameters = spec.get("parameters")
    if not isinstance(parameters, Mapping) or parameters.get("type") != "object":
        reader.problems.append("spec.parameters: must be a JSON Schema of type object")
        parameters = {}
    provides = [
        reader.text(p, "spec.provides", _PROVIDES) for p in reader.sequence(spec.get("provides"), "spec.provides")
    ]
    services = [_service(reader, s, i) for i, s in enumerate(reader.sequence(spec.get("services"), "spec.services"))]
    links = [_link(reader, s, i) for i, s in enumerate(reader.sequence(spec.get("links"), "spec.links"))]
    _consistency(reader, services, links)
    application = Application(
        name=name,
        description=reader.prose(spec.get("description"), "spec.description"),
        provides=tuple(provides),
        parameters=parameters,
        services=tuple(services),
        links=tuple(links),
        initial_for=reader.word(spec.get("initialFor"), "spec.initialFor", NAME, default=""),
    )
    reader.finish()
    return application


def _consistency(reader: Reader, services: Sequence[Service], links: Sequence[Link]) -> None:
    names = [service.name for service in services]
    reader.problems += [f"spec.services: name {n!r} stands twice" for n in sorted(set(names)) if names.count(n) > 1]
    for index, link in enumerate(links):
        for end in (link.source, link.target):
            if "service" in end and end["service"] not in names:
                reader.problems.append(f"spec.links[{index}]: service {end['service']!r} is not among spec.services")


def _service(reader: Reader, value: Any, index: int) -> Service:
    path = f"spec.services[{index}]"
    found = reader.mapping(value, path, ["name", "release", "chart", "placement"], ["values", "forEach"])
    chart = reader.mapping(found.get("chart") or {}, f"{path}.chart", ["name", "version"])
    version = reader.prose(chart.get("version"), f"{path}.chart.version")
    if not version.split() or not all(_COMPARATOR.fullmatch(part) for part in version.split()):
        reader.problems.append(f"{path}.chart.version: {version!r} must be comparators such as `>=0.1.0 <0.2.0`")
    values = found.get("values", {})
    if not isinstance(values, Mapping):
        reader.problems.append(f"{path}.values: must be a mapping")
        values = {}
    if "placement" in values or "global" in values:
        reader.problems.append(f"{path}.values: `placement` and `global` are set by the manager; remove them")
    return Service(
        name=reader.word(found.get("name"), f"{path}.name", NAME),
        release=reader.prose(found.get("release"), f"{path}.release"),
        chart=ChartRequirement(reader.word(chart.get("name"), f"{path}.chart.name", NAME), version),
        placement=_placement(reader, found.get("placement"), f"{path}.placement"),
        values=values,
        for_each=_for_each(reader, found.get("forEach"), f"{path}.forEach"),
    )


def _placement(reader: Reader, value: Any, path: str) -> PlacementRule:
    found = reader.mapping(value or {}, path, [], ["agent", "role", "capabilities"])
    if ("agent" in found) == ("role" in found):
        reader.problems.append(f"{path}: needs either `agent` or `role`")
    if "capabilities" in found and "role" not in found:
        reader.problems.append(f"{path}.capabilities: only together with `role`")
    words = reader.sequence(found.get("capabilities"), f"{path}.capabilities")
    return PlacementRule(
        agent=reader.prose(found.get("agent", ""), f"{path}.agent"),
        role=reader.word(found.get("role"), f"{path}.role", NAME, default=""),
        capabilities=tuple(reader.text(word, f"{path}.capabilities", NAME) for word in words),
    )


def _for_each(reader: Reader, value: Any, path: str) -> Mapping[str, Any]:
    found = value if value is not None else {}
    if not isinstance(found, Mapping) or len(found) > 1:
        reader.problems.append(f"{path}: must be one variable and its list")
        return {}
    for variable in found:
        reader.text(variable, path, _VARIABLE)
        if variable in _RESERVED:
            reader.problems.append(f"{path}: the name {variable!r} is taken; choose another")
    return found


def _link(reader: Reader, value: Any, index: int) -> Link:
    path = f"spec.links[{index}]"
    found = reader.mapping(value, path, ["kind", "from", "to", "topics"], ["forEach"])
    if found.get("kind") not in LINK_KINDS:
        reader.problems.append(f"{path}.kind: must be one of {', '.join(LINK_KINDS)}")
    topics = reader.sequence(found.get("topics"), f"{path}.topics")
    for number, topic in enumerate(topics):
        reader.mapping(
            topic, f"{path}.topics[{number}]", ["name", "type", "channel", "reliability", "durability", "depth"]
        )
    return Link(
        kind=str(found.get("kind")),
        source=_end(reader, found.get("from"), f"{path}.from"),
        target=_end(reader, found.get("to"), f"{path}.to"),
        topics=tuple(topic for topic in topics if isinstance(topic, Mapping)),
        for_each=_for_each(reader, found.get("forEach"), f"{path}.forEach"),
    )


def _end(reader: Reader, value: Any, path: str) -> Mapping[str, str]:
    found = reader.mapping(value or {}, path, [], _LINK_END)
    if len(found) != 1:
        reader.problems.append(f"{path}: needs exactly one of {', '.join(_LINK_END)}")
        return {"agent": ""}
    return {key: reader.prose(text, f"{path}.{key}") for key, text in found.items()}
