"""Problems of an application's templates: unknown names, and samples of its parameters that give releases with names,
placements or values that their charts refuse.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.defaults import with_defaults
from robotkube.foundation.documents.core.patterns import NAME
from robotkube.foundation.documents.core.schema_samples import Sampler
from robotkube.foundation.documents.core.value_templates import FOR_EACH_KEYS, expand_for_each
from robotkube.foundation.documents.core.wrong_keys import NOTHING_WRONG, WrongKeys
from robotkube.foundation.documents.core.yaml_codec import join
from robotkube.registry.catalogue.core.applications import Application, Link, Service
from robotkube.registry.catalogue.core.links.circles import circle_problems
from robotkube.registry.catalogue.core.links.end_validation import end_problems
from robotkube.registry.catalogue.core.links.loops import link_variables, repetitions
from robotkube.registry.catalogue.core.message_types.carried import value_types
from robotkube.registry.catalogue.core.sources import ChartFolder, Tools, dotted
from robotkube.registry.charts.core.values_schemas import overlay

Problem = tuple[str, str]
"""Key, text."""

LOOPS_TRIED_MAX = 3
SHOWN_CHARACTERS_MAX = 120
EXPRESSION = "write an expression of docs/reference/contracts.md"
CHART_NAMES = ("name", "version", "digest")
TASK_NAMES = ("name", "namespace", "event", "rule", "trace", "time", "requester")
AGENT, OTHER_AGENT = "vehicle-00", "vehicle-01"

_OF_ALL_TEMPLATES = re.compile(
    r"spec(\.(parameters|agents|provides|initialFor)\b.*|\.services(\[\d+\](\.(name|forEach)\b.*)?)?"
    r"|\.links\[\d+\]\.forEach.*)?",
    re.ASCII,
)
"""Keys of an application from which names in its templates come."""

_TASK = {
    "name": "task-1", "namespace": "cloud-0", "event": "event-1", "rule": "rule-1", "trace": "0" * 32,
    "time": "2026-11-21T10:00:00Z", "requester": "cloud-0/event-detector",
}  # fmt: skip
_TOPIC = {
    "name": "/vehicles/vehicle_00/pose", "type": "geometry_msgs/msg/PoseStamped", "channel": "telemetry",
    "reliability": "reliable", "durability": "volatile", "depth": 10,
}  # fmt: skip


def application_problems(
    application: Application,
    folders: Mapping[str, Sequence[ChartFolder]],
    tools: Tools,
    wrong: WrongKeys = NOTHING_WRONG,
) -> list[Problem]:
    """Every problem of the templates; `folders` are, per service, the charts that it may get. What follows from keys
    that are `wrong` already is left out."""
    named = list(name_problems(application, tools, wrong))
    if _names_unknown(wrong):
        return named
    sampler = Sampler(application.parameters, tools.validate)
    unsampled = list(_sampling(sampler))
    problems = [*unsampled, *named]
    reported = {key for key, _ in problems}
    samples = sampler.objects()
    if unsampled and not samples:
        return problems  # what the templates would say of nothing follows from that
    samples = samples or [{}]
    tries = [
        [
            problem
            for sample in samples
            for listed in _listed(application)
            for problem in wrong.free(
                _Trial(application, {**names, **listed}, sample, folders, tools, wrong).problems()
            )
        ]
        for names in _modes(application)
    ]
    best = min(tries, key=lambda attempt: len({key for key, _ in attempt}))
    circles = () if wrong.touch("spec.links") else _circles(application, samples, tools)
    for key, text in [*best, *circles]:
        if key not in reported:
            reported.add(key)
            problems.append((key, text))
    return problems


def _listed(application: Application) -> Sequence[Mapping[str, Any]]:
    """The lists of agents with which an application must work: all with two agents, and all empty."""
    if not application.agents:
        return [{}]
    return [{"agents": dict.fromkeys(application.agents, agents)} for agents in ([AGENT, OTHER_AGENT], [])]


def _sampling(sampler: Sampler) -> Iterator[Problem]:
    for name, values in sampler.properties.items():
        if not values:
            text = "no value was found that its schema accepts, so its templates cannot be tried"
            yield f"spec.parameters.properties.{name}", f"{text}; add `examples: [...]` with one that fits"


def _circles(application: Application, samples: Sequence[Mapping[str, Any]], tools: Tools) -> Iterator[Problem]:
    placed = {service.name: AGENT for service in application.services}
    names = [
        {"placement": placed, "parameters": with_defaults(application.parameters, sample), **listed, **mode, **other}
        for sample in samples
        for listed in _listed(application)
        for mode in ([] if application.bridges else _modes(application))
        for other in ({}, {"agent": OTHER_AGENT} if "agent" in mode else {})
    ]
    yield from circle_problems(application, names, (AGENT, OTHER_AGENT), tools.render)


def _modes(application: Application) -> Sequence[Mapping[str, Any]]:
    """The names in addition to parameters under which the application may be used: as a bridge, by an agent, by a
    task."""
    if application.bridges:
        return [{"agent": AGENT, "topics": {"out": [_TOPIC], "in": [{**_TOPIC, "name": "/a"}]}}]
    by_agent = {"agent": AGENT}
    return [by_agent] if application.initial_for else [{"task": _TASK}, by_agent]


def _unknown_names(application: Application, tools: Tools) -> Iterator[Problem]:
    """Names and keys that no demand will ever have, also in branches that no sample takes."""
    properties = application.parameters.get("properties")
    closed = application.parameters.get("additionalProperties") is False
    keys: dict[str, Iterable[str] | None] = {
        "parameters": properties if closed and isinstance(properties, Mapping) else () if closed else None,
        "placement": [service.name for service in application.services],
        "task": TASK_NAMES,
        "chart": CHART_NAMES,
        "agent": None,
        "agents": list(application.agents),
    }
    if application.bridges:
        keys = {"agent": None, "topics": ("out", "in")}
    for path, text, variables in _texts(application):
        yield from unknown_references(path, text, keys, variables, tools)


def name_problems(application: Application, tools: Tools, wrong: WrongKeys) -> Iterator[Problem]:
    """Names and keys that no demand will ever have, and templates that are none."""
    return _syntax(application, tools) if _names_unknown(wrong) else _unknown_names(application, tools)


def _names_unknown(wrong: WrongKeys) -> bool:
    """Return whether it is unknown which names the templates may use: they come from keys that are wrong."""
    return any(_OF_ALL_TEMPLATES.fullmatch(key) for key in wrong.keys)


def _syntax(application: Application, tools: Tools) -> Iterator[Problem]:
    """Templates that are none, whatever names there are."""
    for path, text, _ in _texts(application):
        try:
            tools.references(text)
        except DocumentError as error:
            yield path, f"{error}; {EXPRESSION}"


def unknown_references(
    path: str, text: str, keys: Mapping[str, Iterable[str] | None], variables: frozenset[str], tools: Tools
) -> Iterator[Problem]:
    """Unknown names and keys in one template. `keys`: name -> the keys it has, None when they are open."""
    try:
        references = tools.references(text)
    except DocumentError as error:
        yield path, f"{error}; {EXPRESSION}"
        return
    for name, *rest in sorted(references):
        known = keys.get(name)
        if name in variables:
            continue
        if name not in keys:
            yield path, f"{_shown(text)}: unknown name {name!r}; the names are {', '.join(sorted({*keys, *variables}))}"
        elif known is not None and rest and rest[0] not in known:
            yield path, f"{_shown(text)}: {name} has no {rest[0]!r}; it has {', '.join(known) or 'nothing'}"


def _texts(application: Application) -> Iterator[tuple[str, str, frozenset[str]]]:
    """Every template with its path and the forEach variables it may use."""
    for index, service in enumerate(application.services):
        path = f"spec.services[{index}]"
        variables = frozenset(service.for_each)
        yield from template_texts(service.for_each, f"{path}.forEach", frozenset())
        yield from template_texts(service.release, f"{path}.release", variables)
        yield from template_texts(service.placement.agent, f"{path}.placement.agent", variables)
        yield from template_texts(service.values, f"{path}.values", variables)
    for index, link in enumerate(application.links):
        path = f"spec.links[{index}]"
        variables = link_variables(link, application.services)
        yield from template_texts(link.for_each, f"{path}.forEach", frozenset())
        yield from template_texts(dict(link.source), f"{path}.from", variables)
        yield from template_texts(dict(link.target), f"{path}.to", variables)
        yield from template_texts(list(link.topics), f"{path}.topics", variables)


def template_texts(value: Any, path: str, variables: frozenset[str]) -> Iterator[tuple[str, str, frozenset[str]]]:
    """Every text in `value` with its path and the forEach variables around it."""
    if isinstance(value, str):
        yield path, value, variables
    elif isinstance(value, Mapping):
        inner = value.get("forEach") if set(value) == FOR_EACH_KEYS else None
        more = variables | frozenset(inner if isinstance(inner, Mapping) else ())
        for key, item in value.items():
            yield from template_texts(item, join(path, str(key)), variables if key == "forEach" else more)
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from template_texts(item, f"{path}[{index}]", variables)


@dataclass
class _Trial:
    """One rendering of a whole application with one sample of its parameters."""

    application: Application
    names: Mapping[str, Any]
    sample: Mapping[str, Any]
    folders: Mapping[str, Sequence[ChartFolder]]
    tools: Tools
    wrong: WrongKeys
    placed: dict[str, str] = field(default_factory=dict)

    def problems(self) -> Iterator[Problem]:
        """The problems of this rendering, each with the parameters that show it."""
        hint = f" (with parameters {self.sample!r:.{SHOWN_CHARACTERS_MAX}})" if self.sample else ""
        for index, service in enumerate(self.application.services):
            for key, text in self._service(service, f"spec.services[{index}]"):
                yield key, text + hint
        for index, link in enumerate(self.application.links):
            for key, text in self._link(link, f"spec.links[{index}]"):
                yield key, text + hint
        if self.wrong.touch("spec.links") or self.wrong.touch("spec.services"):
            return
        for key, text in end_problems(self.application, self._given(), self.folders, self.tools):
            yield key, text + hint

    def _given(self) -> dict[str, Any]:
        """The names for templates outside of every loop."""
        if "topics" in self.names:
            return dict(self.names)
        parameters = with_defaults(self.application.parameters, self.sample)
        return {**self.names, "parameters": parameters, "placement": self.placed}

    def _service(self, service: Service, path: str) -> Iterator[Problem]:
        try:
            scopes = list(islice(expand_for_each(service.for_each, self._given(), self.tools.render), LOOPS_TRIED_MAX))
        except DocumentError as error:
            yield f"{path}.forEach", f"{error}; give a list"
            return
        for scope in scopes:
            yield from self._release_name(service, path, scope)
            yield from self._word(service.placement.agent, f"{path}.placement.agent", scope)
            self.placed[service.name] = AGENT
            its_chart = dict(zip(CHART_NAMES, ("chart", "0.0.0", "sha256:0"), strict=True))
            values, problems = rendered(service.values, f"{path}.values", {**scope, "chart": its_chart}, self.tools)
            yield from problems
            unfilled = WrongKeys(tuple(key for key, _ in problems))
            for folder in self.folders.get(service.name, ()):
                yield from unfilled.beside(value_problems(folder, values, f"{path}.values", self.tools))
                if not problems:
                    yield from value_types(folder, values, f"{path}.values", self.tools.render)

    def _release_name(self, service: Service, path: str, scope: Mapping[str, Any]) -> Iterator[Problem]:
        name, problems = rendered(service.release, f"{path}.release", scope, self.tools)
        yield from problems
        if not problems and not (isinstance(name, str) and NAME.fullmatch(name)):
            text = f"{_shown(service.release)} gives {name!r:.80}, which is no name of a release"
            yield f"{path}.release", f"{text}; narrow the parameters or use letters a-z, digits and hyphens, at most 63"

    def _word(self, template: str, path: str, scope: Mapping[str, Any]) -> Iterator[Problem]:
        value, problems = rendered(template, path, scope, self.tools)
        yield from problems
        if not problems and not isinstance(value, str):
            yield path, f"{_shown(template)} gives {value!r:.80}; it must give the name of one agent"

    def _link(self, link: Link, path: str) -> Iterator[Problem]:
        try:
            names = self._given()
            loops = repetitions(link, self.application.services, names, self.tools.render)
            scopes = [{**names, **loop} for loop in islice(loops, LOOPS_TRIED_MAX)]
        except DocumentError as error:
            yield f"{path}.forEach", f"{error}; give a list"
            return
        for scope in scopes:
            for end, where in ((link.source, "from"), (link.target, "to")):
                for key in ("agent", "role"):
                    yield from self._word(end.get(key, ""), f"{path}.{where}.{key}", scope)
            yield from rendered(list(link.topics), f"{path}.topics", scope, self.tools)[1]


def rendered(value: Any, path: str, names: Mapping[str, Any], tools: Tools) -> tuple[Any, list[Problem]]:
    """`value` with every forEach expanded and templates filled, and every template that could not be (with its
    path)."""
    problems: list[Problem] = []
    return _fill(value, path, names, tools, problems), problems


def _fill(value: Any, path: str, names: Mapping[str, Any], tools: Tools, problems: list[Problem]) -> Any:
    if isinstance(value, str):
        return _one(value, path, names, tools, problems)
    if isinstance(value, Mapping):
        return {key: _fill(item, join(path, str(key)), names, tools, problems) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [
            filled for i, item in enumerate(value) for filled in _items(item, f"{path}[{i}]", names, tools, problems)
        ]
    return value


def _items(item: Any, path: str, names: Mapping[str, Any], tools: Tools, problems: list[Problem]) -> Iterator[Any]:
    if not (isinstance(item, Mapping) and set(item) == FOR_EACH_KEYS):
        yield _fill(item, path, names, tools, problems)
        return
    for_each, each = item["forEach"], item["each"]
    if not isinstance(each, list) or not isinstance(for_each, Mapping) or len(for_each) != 1:
        problems.append((path, "forEach needs one variable and `each` needs a list; write both"))
        return
    try:
        scopes = list(islice(expand_for_each(for_each, names, tools.render), LOOPS_TRIED_MAX))
    except DocumentError as error:
        problems.append((f"{path}.forEach", f"{error}; give a list"))
        return
    for scope in scopes:
        for index, inner in enumerate(each):
            yield from _items(inner, f"{path}.each[{index}]", scope, tools, problems)


def _one(text: str, path: str, names: Mapping[str, Any], tools: Tools, problems: list[Problem]) -> Any:
    try:
        return tools.render(text, names)
    except DocumentError as error:
        fix = "give the parameter a default, require it, or use `| default(...)`" if "undefined" in str(error) else ""
        fix = fix or ("the parameter is optional: use `| default(...)`" if "attribute" in str(error) else "correct it")
        problems.append((path, f"{'; '.join(error.problems)} in {_shown(text)}; {fix}"))
        return None


def value_problems(folder: ChartFolder, values: Mapping[str, Any], path: str, tools: Tools) -> Iterator[Problem]:
    """The places at which `values`, laid over those of the chart, break the chart's schema."""
    if folder.schema is None:
        return
    given = {**values, "placement": {"agent": AGENT}, "global": {"plan": "20261121-100000-000000"}}
    for place, message in tools.violations(folder.schema, overlay(folder.values, given)):
        text = f"values.schema.json of {folder.path} refuses this: {message:.200}"
        yield dotted(path, place), f"{text}; correct the value or narrow the parameters"


def _shown(text: str) -> str:
    return f"template {text!r:.{SHOWN_CHARACTERS_MAX}}"
