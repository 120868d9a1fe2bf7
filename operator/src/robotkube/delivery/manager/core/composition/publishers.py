"""Publishers of ROS topics: on one place (a Node's ROS network) each topic has one, as far as charts' interfaces say.

Who subscribes to a topic with two publishers gets both mixed, and cannot tell whose a message is. A release publishes
what the interfaces of its chart say (medium ros, direction out), rendered with its values; a bridge what its links
bring in. Of a chart without such an interface, of one that cannot be rendered, and of a topic with a pattern
(`{agent}`) nothing is known, so nothing is refused for them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from robotkube.delivery.manager.core.composition.topic_merge import End
from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.registry.catalogue.core.chart_versions import ChartVersion
from robotkube.registry.catalogue.core.expected_topics import OUT, ROS, interface_topics

SHARED_TOPICS = frozenset({"/diagnostics", "/parameter_events", "/rosout", "/tf", "/tf_static"})
"""Topics that ROS means for any number of publishers: a message says itself whose it is."""

Spot = tuple[str, str]
"""A place and the topic there."""

Publisher = str | End
"""The key of a release, or a bridge."""

Publishers = dict[Spot, Publisher]


def declares_topics(chart: ChartVersion) -> bool:
    """Whether the chart's entry says what it publishes in ROS."""
    return any(_is_output(interface) for interface in chart.interfaces)


def published_topics(chart: ChartVersion, values: Mapping[str, Any], render: Render) -> Iterator[str]:
    """The topics that a release of the chart publishes with these values, which are laid over the chart's own."""
    for interface in filter(_is_output, chart.interfaces):
        try:
            topics = [one.topic for one in interface_topics(interface, values, render)]
        except DocumentError:
            continue
        yield from (topic for topic in topics if is_one_publishers(topic))


def is_one_publishers(topic: str) -> bool:
    """Whether a second publisher of the topic is refused."""
    return topic not in SHARED_TOPICS and "{" not in topic


def described(publisher: Publisher) -> str:
    """The publisher in words."""
    return f"release {publisher}" if isinstance(publisher, str) else f"the {publisher[0]} bridge of {publisher[1]}"


def _is_output(interface: Mapping[str, Any]) -> bool:
    return (interface["medium"], interface["direction"]) == (ROS, OUT)
