"""Publishers of ROS topics: on one place (a Node's ROS network) each topic has one, as far as charts' interfaces say.

Who subscribes to a topic with two publishers gets both mixed, and cannot tell whose a message is. A release publishes
what the interfaces of its chart say (medium ros, direction out), rendered with its values; a bridge what its links
bring in. Of a chart without such an interface, of one that cannot be rendered, and of a topic with a pattern
(`{agent}`) nothing is known, so nothing is refused for them. A topic that is too long for ROS is refused at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from robotkube.delivery.manager.core.composition.topic_merge import End
from robotkube.errors import DocumentError, RefusalError
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.registry.catalogue.core.chart_versions import ChartVersion
from robotkube.registry.catalogue.core.expected_topics import OUT, ROS, ros_topic_names
from robotkube.robots.ros.core.topic_patterns import length_problem

SHARED_TOPICS = frozenset({"/diagnostics", "/parameter_events", "/rosout", "/tf", "/tf_static"})
"""Topics that ROS means for any number of publishers: a message says itself whose it is."""

Spot = tuple[str, str]
"""A place and the topic there."""

Publisher = str | End
"""The key of a release, or a bridge."""

Publishers = dict[Spot, Publisher]


def declares_topics(chart: ChartVersion) -> bool:
    """Return whether the chart's entry says what it opens in ROS."""
    return any(interface["medium"] == ROS for interface in chart.interfaces)


def published_topics(chart: ChartVersion, values: Mapping[str, Any], render: Render) -> Iterator[str]:
    """The topics that a release of the chart publishes with these values, which are laid over the chart's own.
    RefusalError when it would open one, in either direction, that ROS does not take."""
    for interface in (one for one in chart.interfaces if one["medium"] == ROS):
        try:
            topics = ros_topic_names(interface, values, render)
        except DocumentError:
            continue
        for topic in topics:
            refuse_too_long(topic, f"interface {interface['name']} of chart {chart.chart}")
        if interface["direction"] == OUT:
            yield from filter(is_one_publishers, topics)


def refuse_too_long(topic: str, whose: str) -> None:
    """RefusalError when ROS does not take a topic of this length."""
    if problem := length_problem(topic):
        raise RefusalError("CompositionFailed", f"topic {topic:.60}... of {whose} {problem}")


def is_one_publishers(topic: str) -> bool:
    """Return whether a second publisher of the topic is refused."""
    return topic not in SHARED_TOPICS and "{" not in topic


def described(publisher: Publisher) -> str:
    """The publisher in words."""
    return f"release {publisher}" if isinstance(publisher, str) else f"the {publisher[0]} bridge of {publisher[1]}"
