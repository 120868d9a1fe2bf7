"""The page of log lines is that of the code, and what the code logs arrives with these words and keys."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from ci.reference import logs
from ci.reference.logs import LogEvent, events
from robotkube.foundation.runtime.settings_file import split_message

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


@pytest.fixture(scope="module")
def every() -> Sequence[LogEvent]:
    """All events, read from the code while tests run: reading it takes a second, and every process collects tests."""
    return events()


def test_the_page_of_log_lines_is_current(every: Sequence[LogEvent]) -> None:
    """A word or a key that changed: run `make reference`, and say so in CHANGELOG.md as "Renamed"."""
    assert logs.PAGE.read_text(encoding="utf-8") == logs.page(every), "run: make reference"


def test_the_words_of_every_event_stand_in_its_call() -> None:
    assert logs.without_words() == WITHOUT_WORDS


def test_lines_of_loggers_arrive_as_their_events_and_keys(every: Sequence[LogEvent]) -> None:
    of_loggers = [event for event in every if event.level and not event.package.startswith(logs.SENTENCES)]
    assert len(of_loggers) > 100
    for event in of_loggers:
        said, fields = split_message(logs.PLACE.sub("7", event.text))
        assert (said, tuple(fields)) == (event.event.replace("...", "7"), event.keys), event


def test_no_key_of_an_event_is_one_of_every_line(every: Sequence[LogEvent]) -> None:
    for event in every:
        assert not OF_EVERY_LINE.intersection(event.keys), event
        assert len(set(event.keys)) == len(event.keys), event
        assert "reason" not in event.keys[:-1] or not event.level, f"the reason is the rest of the line: {event}"
