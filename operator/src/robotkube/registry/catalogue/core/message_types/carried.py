"""Message types in an application that nobody could carry or receive: those of links between agents, which bridges
carry, and those that its values give to charts of packaged images."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.foundation.documents.core.yaml_codec import join
from robotkube.registry.catalogue.core.applications import Application
from robotkube.registry.catalogue.core.expected_topics import ROS, expected_topics
from robotkube.registry.catalogue.core.message_types.published import only_packaged
from robotkube.registry.catalogue.core.sources import ChartFolder
from robotkube.registry.charts.core.values_schemas import overlay
from robotkube.robots.ros.core.known_types import instead, is_packaged, unknown_type


def bridged_type(type_name: str) -> str:
    """Why no bridge carries a topic of this type, and what to do; empty when bridges do."""
    if is_packaged(type_name):
        return ""
    return f"{unknown_type(type_name)}, so no bridge carries it; {instead()}"


def link_problems(application: Application) -> Iterator[tuple[str, str]]:
    """Key and text of every type of a link that no bridge carries."""
    for index, link in enumerate(application.links):
        for number, topic in enumerate(link.topics):
            problem = bridged_type(str(topic.get("type", "")))
            if problem:
                yield f"spec.links[{index}].topics[{number}].type", problem


def value_types(folder: ChartFolder, values: Mapping[str, Any], path: str, render: Render) -> Iterator[tuple[str, str]]:
    """Key and text of every type in an application's `values` of a chart, which stand at `path`, that the chart would
    open in the ROS graph and its images, packaged ones, do not know."""
    if not only_packaged(folder.entry_images):
        return
    try:
        topics = expected_topics(folder.interfaces, overlay(folder.values, values), render)
    except DocumentError:
        return  # what these values give is no topic: the chart's schema or its process says so
    for type_name in dict.fromkeys(topic.type for topic in topics if topic.medium == ROS):
        if not is_packaged(type_name):
            place = next(_places(values, path, type_name), path)
            yield place, f"{unknown_type(type_name)}, and the chart runs {', '.join(folder.entry_images)}; {instead()}"


def _places(value: Any, path: str, text: str) -> Iterator[str]:
    """The paths at which a text stands."""
    if value == text:
        yield path
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from _places(item, join(path, str(key)), text)
    elif isinstance(value, (list, tuple)):
        for index, item in enumerate(value):
            yield from _places(item, f"{path}[{index}]", text)
