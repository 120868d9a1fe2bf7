"""Applications: what the catalogue offers, as services, links between them, and parameters that a task gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.entry_reader import EntryReader, read_one_of, read_words
from robotkube.foundation.documents.core.patterns import (
    CAPABILITY,
    DOCUMENTS_CACHED_MAX,
    NAME,
    ROS_TYPE,
    VALUES_PATH,
    VARIABLE,
)
from robotkube.foundation.documents.core.reader import Reader
from robotkube.registry.catalogue.core.entries import read_description, read_for_each, read_head
from robotkube.registry.catalogue.core.guarantees import GuaranteeRequirement, read_requirements
from robotkube.registry.catalogue.core.interface_declarations import DURABILITIES, RELIABILITIES
from robotkube.registry.catalogue.core.versions import is_range
from robotkube.registry.evidence.core.application_statements import MISSING as NO_EVIDENCE
from robotkube.registry.evidence.core.application_statements import document_digest

LINK_KINDS = ("mqtt", "ros")
TOPIC_KEYS = ("name", "type", "channel", "reliability", "durability", "depth")
TOPIC_KEYS_OPTIONAL = ("deadline_seconds",)
CHANNELS = ("safety", "telemetry", "bulk")
DEPTH_MAX = 100_000
DEADLINE_SECONDS_MIN, DEADLINE_SECONDS_MAX = 0.05, 10
AGENT_LISTS_MAX = 16
SET_BY_MANAGER = ("placement", "global")
RESERVED = frozenset({"parameters", "agent", "agents", "task", "placement", "topics", "chart"})

_LINK_END = ("agent", "medium", "role", "service")
_MEDIA = ("mqtt",)


@dataclass(frozen=True)
class ChartRequirement:
    """A chart by `name` or by what it `provides`, in a range of versions (comparators, empty allows all), whose
    guarantees meet every requirement."""

    name: str
    version: str
    provides: str = ""
    requirements: tuple[GuaranteeRequirement, ...] = ()

    def __str__(self) -> str:
        chart = f"chart {self.name}" if self.name else f"chart that provides {self.provides}"
        needs = "".join(f", {requirement}" for requirement in self.requirements)
        return f"{chart} {self.version or '(any version)'}{needs}"


@dataclass(frozen=True)
class PlacementRule:
    """A rule of where a service may run: on the named agent (a template), or on one agent, of the role when one is
    given, that has all capabilities. `spread`: no two instances of it on one agent."""

    agent: str = ""
    role: str = ""
    capabilities: tuple[str, ...] = ()
    spread: bool = False


@dataclass(frozen=True)
class Service:
    """One microservice of an application; `release` and `values` are templates, `for_each` is variable -> list.
    `unite`: paths of lists in the values (keys joined by dots) that are merged when demands share the release."""

    name: str
    release: str
    chart: ChartRequirement
    placement: PlacementRule
    values: Mapping[str, Any]
    for_each: Mapping[str, Any] = field(default_factory=dict)
    unite: tuple[str, ...] = ()


@dataclass(frozen=True)
class Link:
    """Topics that go from one end to another; an end is {agent: template} | {role: name} | {service: name}.

    Kind `ros`: both ends are services, they run on one node, and ROS itself carries the topics."""

    kind: str
    source: Mapping[str, str]
    target: Mapping[str, str]
    topics: tuple[Mapping[str, Any], ...] = ()
    for_each: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class AgentList:
    """Agents that templates may name together: those of the role, when one is given, whose Nodes have all
    capabilities."""

    role: str = ""
    capabilities: tuple[str, ...] = ()


@dataclass(frozen=True)
class Application:
    """What the catalogue offers. `parameters` is a JSON Schema; `initial_for` a role or empty; an application that
    provides `link/<kind>` gives the bridge service that composition puts at both ends of links of that kind. `agents`:
    the lists of agents that its templates may use, by name.

    `digest` is that of its document; `evidence` that of the envelope beside it, empty when there is none; `assured`
    only when that was checked, else `evidence_problem` says what is missing."""

    name: str
    description: str
    provides: tuple[str, ...]
    parameters: Mapping[str, Any]
    services: tuple[Service, ...]
    links: tuple[Link, ...] = ()
    initial_for: str = ""
    digest: str = ""
    evidence: str = ""
    assured: bool = False
    evidence_problem: str = NO_EVIDENCE
    agents: Mapping[str, AgentList] = field(default_factory=dict)

    @property
    def area(self) -> str:
        """The word in commit subjects: the first part of what it provides first, else its name."""
        return self.provides[0].partition("/")[0] if self.provides else self.name

    @property
    def bridges(self) -> tuple[str, ...]:
        """Kinds of links whose bridge it is."""
        return tuple(word.removeprefix("link/") for word in self.provides if word.startswith("link/"))


def read_application(text: str, path: str) -> Application:
    """An application of the catalogue; its name is the file's name. DocumentError names every problem."""
    application, problems = read_application_partly(text, path)
    if problems:
        raise DocumentError(path, problems)
    return application


@lru_cache(DOCUMENTS_CACHED_MAX)
def read_application_partly(text: str, path: str) -> tuple[Application, tuple[str, ...]]:
    """An application as far as it can be read, and every problem: what has one is empty. DocumentError when the text
    is no mapping in YAML."""
    reader = EntryReader(path)
    document, name = read_head(reader, text, "Application")
    spec = reader.mapping(
        document.get("spec") or {},
        "spec",
        ["description", "provides", "parameters"],
        ["initialFor", "agents", "services", "links"],
    )
    if name:
        reader.equal(path, "path", f"applications/{name}.yaml")
    parameters = spec.get("parameters")
    if not isinstance(parameters, Mapping) or parameters.get("type") != "object":
        reader.problems.append("spec.parameters: must be a JSON Schema of type object")
        parameters = {}
    services = [_service(reader, s, i) for i, s in enumerate(reader.sequence(spec.get("services"), "spec.services"))]
    links = [_link(reader, s, i) for i, s in enumerate(reader.sequence(spec.get("links"), "spec.links"))]
    _consistency(reader, services, links)
    application = Application(
        name=name,
        description=read_description(reader, spec.get("description"), "spec.description"),
        provides=read_words(reader, spec.get("provides"), "spec.provides", CAPABILITY),
        parameters=parameters,
        services=tuple(services),
        links=tuple(links),
        initial_for=reader.word(spec.get("initialFor"), "spec.initialFor", NAME, default=""),
        agents=_agent_lists(reader, spec.get("agents")),
        digest=document_digest(text),
    )
    return application, tuple(reader.problems)


def _agent_lists(reader: Reader, value: Any) -> Mapping[str, AgentList]:
    lists = value if value is not None else {}
    if not isinstance(lists, Mapping) or len(lists) > AGENT_LISTS_MAX:
        reader.problems.append(f"spec.agents: must be a mapping of at most {AGENT_LISTS_MAX} lists")
        return {}
    return {
        reader.text(name, f"spec.agents.{name}", VARIABLE): _agent_list(reader, asked, f"spec.agents.{name}")
        for name, asked in lists.items()
    }


def _agent_list(reader: Reader, value: Any, path: str) -> AgentList:
    asked = reader.mapping(value or {}, path, [], ["role", "capabilities"])
    capabilities = read_words(reader, asked.get("capabilities"), f"{path}.capabilities", NAME)
    role = reader.word(asked.get("role"), f"{path}.role", NAME, default="")
    if not role and not capabilities:
        reader.problems.append(f"{path}: needs `role`, `capabilities` or both")
    return AgentList(role, capabilities)


def _consistency(reader: Reader, services: Sequence[Service], links: Sequence[Link]) -> None:
    names = [service.name for service in services]
    reader.problems += [f"spec.services: name {n!r} stands twice" for n in sorted(set(names)) if names.count(n) > 1]
    for index, link in enumerate(links if all(names) else ()):
        for end in (link.source, link.target):
            if "service" in end and end["service"] not in names:
                reader.problems.append(f"spec.links[{index}]: service {end['service']!r} is not among spec.services")


def _service(reader: Reader, value: Any, index: int) -> Service:
    path = f"spec.services[{index}]"
    service = reader.mapping(value, path, ["name", "release", "chart", "placement"], ["values", "forEach", "unite"])
    values = service.get("values", {})
    if not isinstance(values, Mapping):
        reader.problems.append(f"{path}.values: must be a mapping")
        values = {}
    if any(key in values for key in SET_BY_MANAGER):
        reader.problems.append(f"{path}.values: `placement` and `global` are set by the manager; remove them")
    release = reader.prose(service.get("release"), f"{path}.release")
    if service.get("release") == "":
        reader.problems.append(f"{path}.release: must not be empty")
    return Service(
        name=reader.word(service.get("name"), f"{path}.name", NAME),
        release=release,
        chart=_chart(reader, service.get("chart"), f"{path}.chart"),
        placement=_placement(reader, service.get("placement"), f"{path}.placement"),
        values=values,
        for_each=read_for_each(reader, service.get("forEach"), f"{path}.forEach", RESERVED),
        unite=read_words(reader, service.get("unite"), f"{path}.unite", VALUES_PATH),
    )


def _chart(reader: Reader, value: Any, path: str) -> ChartRequirement:
    chart = reader.mapping(value or {}, path, [], ["name", "provides", "version", "requirements"])
    if ("name" in chart) == ("provides" in chart):
        reader.problems.append(f"{path}: needs either `name` or `provides`")
    version = reader.prose(chart.get("version", ""), f"{path}.version")
    if "name" in chart and "version" not in chart:
        reader.problems.append(f"{path}.version: missing")
    if isinstance(chart.get("version"), str) and not is_range(version):
        reader.problems.append(f"{path}.version: {version!r:.80} must be comparators such as `>=0.1.0 <0.2.0`")
    return ChartRequirement(
        reader.word(chart.get("name"), f"{path}.name", NAME, default=""),
        version,
        reader.word(chart.get("provides"), f"{path}.provides", CAPABILITY, default=""),
        read_requirements(reader, chart.get("requirements"), f"{path}.requirements"),
    )


def _placement(reader: Reader, value: Any, path: str) -> PlacementRule:
    placement = reader.mapping(value or {}, path, [], ["agent", "role", "capabilities", "spread"])
    if ("agent" in placement) == ("role" in placement or "capabilities" in placement):
        reader.problems.append(f"{path}: needs either `agent`, or `role`, `capabilities` or both")
    capabilities = read_words(reader, placement.get("capabilities"), f"{path}.capabilities", NAME)
    if "capabilities" in placement and not capabilities and "role" not in placement:
        reader.problems.append(f"{path}.capabilities: must name at least one capability")
    agent = reader.prose(placement.get("agent", ""), f"{path}.agent")
    if placement.get("agent") == "":
        reader.problems.append(f"{path}.agent: must not be empty")
    spread = placement.get("spread", False)
    if not isinstance(spread, bool) or (spread and "agent" in placement):
        reader.problems.append(f"{path}.spread: must be true or false, and is nothing for a named agent")
    role = reader.word(placement.get("role"), f"{path}.role", NAME, default="")
    return PlacementRule(agent, role, capabilities, spread is True)


def _link(reader: Reader, value: Any, index: int) -> Link:
    path = f"spec.links[{index}]"
    ros = isinstance(value, Mapping) and value.get("kind") == "ros"
    required = ["kind", "from", "to"]
    optional = [] if ros else ["topics", "forEach"]
    link = reader.mapping(value, path, required, optional)
    kind = read_one_of(reader, link.get("kind"), f"{path}.kind", LINK_KINDS)
    topics = [] if ros else reader.sequence(link.get("topics"), f"{path}.topics")
    if kind == "mqtt" and not topics:
        reader.problems.append(f"{path}.topics: needs at least one topic")
    for number, topic in enumerate(topics):
        _topic(reader, topic, f"{path}.topics[{number}]")
    source = _end(reader, link.get("from"), f"{path}.from", ros)
    target = _end(reader, link.get("to"), f"{path}.to", ros)
    if ros and source == target:
        reader.problems.append(f"{path}: both ends are the same service; remove the link")
    if "medium" in source and "medium" in target:
        reader.problems.append(f"{path}: both ends are the medium; one must be an agent, a role or a service")
    return Link(
        kind=kind,
        source=source,
        target=target,
        topics=tuple(topic for topic in topics if isinstance(topic, Mapping)),
        for_each=read_for_each(reader, link.get("forEach"), f"{path}.forEach", RESERVED),
    )


def _end(reader: Reader, value: Any, path: str, ros: bool) -> Mapping[str, str]:
    keys = ("service",) if ros else _LINK_END
    end = reader.mapping(value or {}, path, [], keys)
    if len(end) != 1:
        reader.problems.append(f"{path}: needs exactly one of {', '.join(keys)}")
        return {"agent": ""}
    if "medium" in end:
        read_one_of(reader, end["medium"], f"{path}.medium", _MEDIA)
    return {key: reader.prose(text, f"{path}.{key}") for key, text in end.items()}


def _topic(reader: Reader, value: Any, path: str) -> None:
    topic = reader.mapping(value, path, TOPIC_KEYS, TOPIC_KEYS_OPTIONAL)
    if not topic:
        return
    reader.prose(topic.get("name", ""), f"{path}.name")
    reader.text(topic.get("type"), f"{path}.type", ROS_TYPE)
    for key, words in (("channel", CHANNELS), ("reliability", RELIABILITIES), ("durability", DURABILITIES)):
        if key in topic:
            read_one_of(reader, topic[key], f"{path}.{key}", words)
    depth = topic.get("depth", 1)
    if isinstance(depth, bool) or not isinstance(depth, int) or not 1 <= depth <= DEPTH_MAX:
        reader.problems.append(f"{path}.depth: must be a whole number from 1 to {DEPTH_MAX}")
    deadline = topic.get("deadline_seconds", DEADLINE_SECONDS_MAX)
    number = isinstance(deadline, int | float) and not isinstance(deadline, bool)
    if not number or not DEADLINE_SECONDS_MIN <= deadline <= DEADLINE_SECONDS_MAX:
        bounds = f"from {DEADLINE_SECONDS_MIN} to {DEADLINE_SECONDS_MAX}"
        reader.problems.append(f"{path}.deadline_seconds: must be a number of seconds {bounds}")
