"""Keys of a document whose value is the name of a topic, or of one per agent."""

from __future__ import annotations

from robotkube.foundation.documents.core.reader import MappingReader
from robotkube.robots.ros.core.topic_patterns import UNREADABLE_TOPIC, TopicPattern


def read_topic_pattern(item: MappingReader, key: str) -> TopicPattern:
    """The topic pattern under `key`; a stand-in for one that cannot be read, which is a problem of the document."""
    text = item.text(key)
    try:
        return TopicPattern(text)
    except ValueError as error:
        if text:
            item.problem(key, str(error))
        return TopicPattern(UNREADABLE_TOPIC)
