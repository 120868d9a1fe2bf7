"""Links of an application, for one sample of its parameters, compared with the charts at their ends: those beside the
registry."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice, product
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.value_templates import render_templates
from robotkube.registry.catalogue.core.applications import Application, Link, Service
from robotkube.registry.catalogue.core.links.ends import Opening, mismatches, opened, taking_part, together
from robotkube.registry.catalogue.core.links.loops import loops_of, repetitions
from robotkube.registry.catalogue.core.sources import ChartFolder, Tools
from robotkube.registry.charts.core.values_schemas import overlay

INSTANCES_MAX = 16

Problem = tuple[str, str]
"""Key, text."""


def end_problems(
    application: Application,
    names: Mapping[str, Any],
    folders: Mapping[str, Sequence[ChartFolder]],
    tools: Tools,
) -> Iterator[Problem]:
    """Every topic of a link that a chart at its end opens otherwise, or not at all. `names` are those for templates,
    `folders`, per service, the charts that it may get. What cannot be rendered is left out: others report it."""
    bridged = [(index, link) for index, link in enumerate(application.links) if link.kind != "ros"]
    if not any("service" in end for _, link in bridged for end in (link.source, link.target)):
        return
    try:
        every = [opening for service in application.services for opening in _openings(service, names, folders, tools)]
        every = together(every, application.links)
        for index, link in bridged:
            yield from _link(link, f"spec.links[{index}]", application, names, every, tools)
    except DocumentError:
        return


def _openings(
    service: Service, names: Mapping[str, Any], folders: Mapping[str, Sequence[ChartFolder]], tools: Tools
) -> Iterator[Opening]:
    """Every instance, with each of the charts that it may get; one of which nothing is known for those too many."""
    loops = loops_of(service.for_each, names, tools.render)
    for loop in loops[:INSTANCES_MAX]:
        scope = {**names, **loop}
        agent = service.placement.agent
        place = f"agent {tools.render(agent, scope)}" if agent else f"service {service.name} {loop}"
        charts = folders.get(service.name, ())
        for folder in charts:
            its_chart = {"name": folder.name, "version": folder.version, "digest": "sha256:0"}
            values = render_templates(service.values, {**scope, "chart": its_chart}, tools.render)
            topics = opened(folder.interfaces, overlay(folder.values, values), tools.render)
            yield Opening(service.name, folder.name, place, loop, topics)
        if not charts:
            yield Opening(service.name, "", place, loop)
    if len(loops) > INSTANCES_MAX:
        yield Opening(service.name, "", "")


def _link(
    link: Link,
    path: str,
    application: Application,
    names: Mapping[str, Any],
    every: Sequence[Opening],
    tools: Tools,
) -> Iterator[Problem]:
    for loop in islice(repetitions(link, application.services, names, tools.render), INSTANCES_MAX):
        ends = [taking_part(end, loop, every) for end in (link.source, link.target)]
        for number, written in enumerate(link.topics):
            topic = tools.render(written, {**names, **loop})
            for source, target in product(*ends):
                if source is None or target is None or source.place != target.place:
                    for key, text in mismatches(topic, source, target, every):
                        yield f"{path}.topics[{number}].{key}", text
