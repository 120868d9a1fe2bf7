"""The page of log lines is that of the code, and what the code logs arrives with these words and keys."""

from __future__ import annotations

import pytest

from ci import log_reference
from ci.log_reference import LogEvent, events
from robotkube.foundation.runtime.settings_file import split_message

EVENTS = events()
OF_LOGGERS = [event for event in EVENTS if event.level and not event.package.startswith(log_reference.SENTENCES)]
OF_EVERY_LINE = {"time", "process", "event", "level"}
WITHOUT_WORDS = [
    "foundation/runtime: self._process.log(event, **{**fields, 'level': record.levelname.lower()})",
    "robots/detector: log.error('%s', error)",
    "robots/detector: log.warning(text, topic.name, policy, count, qos.text(), offered)",
    "robots/detector: self._process.log(record.getMessage(), level=record.levelname.lower())",
    "robots/recording: log.exception('%s', self.failed)",
    "robots/recording: log.exception('%s', self.failed)",
]
"""Calls whose words the page cannot know: errors say what happened themselves, or the words stand somewhere else."""


def name(event: LogEvent) -> str:
    return f"{event.package} {event.event}"


def test_the_page_of_log_lines_is_current() -> None:
    """A word or a key that changed: run `make reference`, and say so in CHANGELOG.md as "Renamed"."""
    assert log_reference.PAGE.read_text(encoding="utf-8") == log_reference.page(EVENTS), "run: make reference"


def test_the_words_of_every_event_stand_in_its_call() -> None:
    assert log_reference.without_words() == WITHOUT_WORDS


@pytest.mark.parametrize("event", OF_LOGGERS, ids=name)
def test_a_line_of_a_logger_arrives_as_its_event_and_keys(event: LogEvent) -> None:
    written = log_reference.PLACE.sub("7", event.text)
    said, fields = split_message(written)
    assert said == event.event.replace("...", "7")
    assert tuple(fields) == event.keys


@pytest.mark.parametrize("event", EVENTS, ids=name)
def test_no_key_of_an_event_is_one_of_every_line(event: LogEvent) -> None:
    assert not OF_EVERY_LINE.intersection(event.keys)
    assert len(set(event.keys)) == len(event.keys)
    assert "reason" not in event.keys[:-1] or not event.level, "the reason is the rest of the line"
