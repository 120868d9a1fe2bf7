"""Measures of success: the results by which an update to a chart version is judged, as its entry names them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.foundation.documents.core.entry_reader import read_words
from robotkube.foundation.documents.core.patterns import NAME, ROS_TOPIC_PATTERN, TOKEN
from robotkube.foundation.documents.core.reader import Reader
from robotkube.robots.ros.core.topic_patterns import AGENT

PATH = "spec.success"
NO_EVENT_OF, PROBES_OF, RATES = "noEventOf", "probesOf", "rates"
MEASURES: Mapping[str, str] = {NO_EVENT_OF: "rule", PROBES_OF: "container", RATES: "topic"}
"""Key of a measure -> what its items name."""
SECONDS_MAX = 3600
HERTZ = (0.001, 10_000)


@dataclass(frozen=True)
class TopicRate:
    """A ROS topic and how often its messages come at least; `{agent}` in it stands for the release's agent."""

    topic: str
    at_least_hz: float

    @property
    def hertz(self) -> str:
        """The rate in words."""
        return f"{self.at_least_hz:g} Hz"


@dataclass(frozen=True)
class SuccessMeasure:
    """The measures by which an update to a version has succeeded on an agent. Within so many seconds after the release
    is healthy there, no event of the rules `no_event_of` about the agent begins, the probes of the containers
    `probes_of` say yes without a break, and the topics `rates` come as often as they say."""

    no_event_of: tuple[str, ...] = ()
    seconds: int = 1
    probes_of: tuple[str, ...] = ()
    rates: tuple[TopicRate, ...] = ()

    def document(self) -> dict[str, Any]:
        """The measures as the entry has them."""
        rates = [{"topic": rate.topic, "atLeastHz": rate.at_least_hz} for rate in self.rates]
        lists: Mapping[str, Sequence[Any]] = {NO_EVENT_OF: self.no_event_of, PROBES_OF: self.probes_of, RATES: rates}
        return {**{key: list(items) for key, items in lists.items() if items}, "seconds": self.seconds}


def read_success(reader: Reader, value: Any) -> SuccessMeasure:
    """The measures of an entry; problems go to the reader."""
    success = reader.mapping(value, PATH, ["seconds"], MEASURES)
    if not any(key in success for key in MEASURES):
        reader.problems.append(f"{PATH}: names no measure; write {' or '.join(MEASURES)}")
    seconds = success.get("seconds")
    if type(seconds) is not int or not 1 <= seconds <= SECONDS_MAX:
        reader.problems.append(f"{PATH}.seconds: must be a whole number from 1 to {SECONDS_MAX}")
        seconds = 1
    for key in MEASURES:
        if key in success and not reader.sequence(success[key], f"{PATH}.{key}"):
            reader.problems.append(f"{PATH}.{key}: must name at least one {MEASURES[key]}")
    return SuccessMeasure(
        no_event_of=read_words(reader, success.get(NO_EVENT_OF), f"{PATH}.{NO_EVENT_OF}", TOKEN),
        seconds=seconds,
        probes_of=read_words(reader, success.get(PROBES_OF), f"{PATH}.{PROBES_OF}", NAME),
        rates=_rates(reader, success.get(RATES)),
    )


def _rates(reader: Reader, value: Any) -> tuple[TopicRate, ...]:
    rates = []
    for index, item in enumerate(reader.sequence(value, f"{PATH}.{RATES}")):
        path = f"{PATH}.{RATES}[{index}]"
        rate = reader.mapping(item, path, ["topic", "atLeastHz"])
        topic = reader.word(rate.get("topic"), f"{path}.topic", ROS_TOPIC_PATTERN)
        if topic.count(AGENT) > 1:
            reader.problems.append(f"{path}.topic: {topic} holds {AGENT} more than once; name it once")
        hertz = rate.get("atLeastHz")
        if isinstance(hertz, bool) or not isinstance(hertz, int | float) or not HERTZ[0] <= hertz <= HERTZ[1]:
            reader.problems.append(f"{path}.atLeastHz: must be a number from {HERTZ[0]} to {HERTZ[1]}")
            hertz = 1.0
        rates.append(TopicRate(topic, float(hertz)))
    return tuple(rates)
