"""Problems of a chart version's entry, alone and against the chart next to the registry: images, interfaces, values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.wrong_keys import WrongKeys
from robotkube.registry.catalogue.core.chart_versions import ChartVersion
from robotkube.registry.catalogue.core.expected_topics import (
    OUT,
    ROS,
    ExpectedTopic,
    declaration_checks,
    expected_topics,
)
from robotkube.registry.catalogue.core.message_types.published import type_problems
from robotkube.registry.catalogue.core.sources import CatalogueSources, ChartFolder, SourceProblem, Tools
from robotkube.registry.catalogue.core.success.measures import PATH
from robotkube.registry.catalogue.core.template_validation import (
    AGENT,
    Problem,
    rendered,
    template_texts,
    unknown_references,
    value_problems,
)
from robotkube.registry.charts.core.values_schemas import overlay
from robotkube.robots.ros.core.topic_patterns import AGENT as AGENT_WORD
from robotkube.robots.ros.core.topic_patterns import TopicPattern

_SET_NAMES = {"agent": None, "start_ns": None}
_SET_SAMPLE = {"agent": AGENT, "start_ns": 1_793_268_000_000_000_000}
_INTERFACE_TEMPLATES = ("topic", "type", "qos", "encoding")


def chart_problems(version: ChartVersion, folder: ChartFolder | None, tools: Tools) -> Iterator[Problem]:
    """What is wrong with one version; `folder` is its chart, None when there is none of this version."""
    yield from interface_names(version, tools)
    filled, problems = _filled_sets(version, tools)
    yield from problems
    if folder is None:
        return
    yield from _images(version, folder)
    for index, values in filled.items():
        yield from value_problems(folder, values, f"spec.suites.sets[{index}].values", tools)
    if not problems:
        yield from _topics(version, folder, filled, tools)


def readable_parts(version: ChartVersion, wrong: WrongKeys) -> ChartVersion:
    """The version without the parts in which a key is wrong."""
    interfaces = () if wrong.touch("spec.interfaces") else version.interfaces
    suites = {} if wrong.touch("spec.suites") else version.suites
    success = version.success if interfaces and not wrong.touch(PATH) else None
    return replace(version, interfaces=interfaces, suites=suites, success=success)


def interface_names(version: ChartVersion, tools: Tools) -> Iterator[Problem]:
    """Unknown names in the templates of a version's interfaces."""
    for index, interface in enumerate(version.interfaces):
        path = f"spec.interfaces[{index}]"
        variables = frozenset(interface.get("forEach") or ())
        parts = {key: interface[key] for key in _INTERFACE_TEMPLATES if key in interface}
        templates = [
            *template_texts(interface.get("forEach"), f"{path}.forEach", frozenset()),
            *template_texts(parts, path, variables),
        ]
        for where, text, known in templates:
            yield from unknown_references(where, text, {"values": None}, known, tools)


def _filled_sets(version: ChartVersion, tools: Tools) -> tuple[dict[int, Mapping[str, Any]], list[Problem]]:
    """The values of every test set that could be rendered, and what could not."""
    filled: dict[int, Mapping[str, Any]] = {}
    problems: list[Problem] = []
    for index, item in enumerate(version.suites.get("sets", ())):
        path = f"spec.suites.sets[{index}]"
        unknown = [
            problem
            for where, text, variables in template_texts(item, path, frozenset())
            for problem in unknown_references(where, text, _SET_NAMES, variables, tools)
        ]
        values, more = rendered(item, path, _SET_SAMPLE, tools)
        problems += unknown or more
        if not unknown and not more:
            filled[index] = values["values"]
    return filled, problems


def _topics(
    version: ChartVersion, folder: ChartFolder, filled: Mapping[int, Mapping[str, Any]], tools: Tools
) -> Iterator[Problem]:
    """Problems for which the interface suite would refuse before it installs anything."""
    expected: dict[str, tuple[ExpectedTopic, ...]] = {}
    for index, values in filled.items():
        try:
            expected[str(index)] = expected_topics(version.interfaces, overlay(folder.values, values), tools.render)
        except DocumentError as error:
            yield "spec.interfaces", f"with the values of spec.suites.sets[{index}]: {error}; correct one of them"
    for number, topics in expected.items():
        yield from _types(version, topics, f"with the values of spec.suites.sets[{number}]")
    if filled and len(expected) == len(filled):
        given = [topic for topics in expected.values() for topic in topics]
        yield from _rated_topics(version, given)
        for check in declaration_checks(version.interfaces, expected):
            if not check.passed:
                yield "spec.interfaces", f"{check.name}: {check.found}; {check.fix}"


def _rated_topics(version: ChartVersion, given: Sequence[ExpectedTopic]) -> Iterator[Problem]:
    """Topics that an update is measured by, and that the chart does not declare as ROS outputs for any test set."""
    published = [topic.example for topic in given if (topic.medium, topic.direction) == (ROS, OUT)]
    for index, rate in enumerate(version.success.rates if version.success else ()):
        fits = [topic for topic in published if TopicPattern(rate.topic).agent(topic) is not None]
        if not fits:
            has = ", ".join(published) or "none"
            text = f"{rate.topic} is no ROS topic that an interface of direction out gives (with the test sets: {has})"
            yield f"{PATH}.rates[{index}].topic", f"{text}; name one of them, with {AGENT_WORD} for the agent"


def _types(version: ChartVersion, topics: Sequence[ExpectedTopic], condition: str) -> Iterator[Problem]:
    places = {interface["name"]: index for index, interface in enumerate(version.interfaces)}
    for name, text in type_problems(topics, version.images):
        yield f"spec.interfaces[{places[name]}].type", f"{text} ({condition})"


def _images(version: ChartVersion, folder: ChartFolder) -> Iterator[Problem]:
    if folder.images is not None and set(folder.images) != set(version.images):
        has = ", ".join(sorted(folder.images)) or "none"
        text = f"{', '.join(version.images) or 'none'} here, {has} in the annotation robotkube.io/images"
        yield "spec.images", f"{text} of {folder.path}/Chart.yaml; name the same images in both"


def folder_findings(
    sources: CatalogueSources, charts: Mapping[str, Sequence[ChartVersion]], broken: AbstractSet[str]
) -> Iterator[SourceProblem]:
    """Charts next to the registry whose version has no entry."""
    for folder in sources.folders.values():
        if folder.name not in broken and not any(v.version == folder.version for v in charts.get(folder.name, ())):
            entry = f"{sources.root}/charts/{folder.name}/{folder.version}.yaml"
            has = ", ".join(v.version for v in charts.get(folder.name, ())) or "none"
            text = f"{folder.version} has no entry in the catalogue (entries: {has})"
            yield SourceProblem(
                f"{folder.path}/Chart.yaml", "version", f"{text}; write {entry}, or correct the version"
            )
