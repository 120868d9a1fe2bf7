"""The documents of links: what a bridge carries to the broker and from there, with its rate, out of its metrics.

A rate needs two readings; until then, and while a bridge does not answer, it is None: not known.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

_SERIES = re.compile(r'robotkube_bridge_(\w+)(?:\{(?:direction="(in|out)",)?topic="([^"]*)"\})? ([0-9.e+-]+)')
_DIRECTION_OF = {"matched_sources": "out", "matched_sinks": "in", "latency_seconds": "in"}
MESSAGES, REFUSED = "messages_total", "topics_refused"
LINKS_MAX, SENTENCES_MAX, SENTENCE_CHARACTERS_MAX = 500, 100, 300
"""Of one bridge: whoever has an agent answers what he likes."""

Link = tuple[str, str]
"""Direction and topic."""


@dataclass(frozen=True)
class BridgeReading:
    """What a bridge's page /metrics said at `time_ms`: values by name of each link, and how many topics it does not
    carry."""

    time_ms: int
    links: Mapping[Link, Mapping[str, float]] = field(default_factory=dict)
    refused: int = 0


def read_metrics(text: str, time_ms: int) -> BridgeReading:
    """The reading in a page; ValueError when it has nothing of a bridge."""
    links: dict[Link, dict[str, float]] = {}
    refused = None
    for line in text.splitlines():
        match = _SERIES.fullmatch(line)
        if match is None:
            continue
        name, direction, topic, value = match.groups()
        direction = direction or _DIRECTION_OF.get(name, "")
        if name == REFUSED:
            refused = int(float(value))
        elif topic and direction:
            links.setdefault((direction, topic), {})[name] = float(value)
    if refused is None:
        raise ValueError("no metrics of a bridge")
    return BridgeReading(time_ms, links, refused)


@dataclass
class LinkRates:
    """What was read of one bridge before: the last reading, and since when each link is silent."""

    before: BridgeReading | None = None
    silent_since_ms: dict[Link, int] = field(default_factory=dict)

    def documents(self, release: str, reading: BridgeReading, not_carried: Sequence[str] = ()) -> dict[str, Any]:
        """The documents of the bridge `release` (`<namespace>/<release>`), by key, after this reading."""
        documents = {}
        for link, values in islice(reading.links.items(), LINKS_MAX):
            if MESSAGES in values:
                documents[f"{release}/{link[0]}{link[1]}"] = self._document(release, link, values, reading.time_ms)
        self.silent_since_ms = {link: since for link, since in self.silent_since_ms.items() if link in reading.links}
        self.before = reading
        refusals = {
            f"{release}/refused/{number}": {**_link(release, "", ""), "problem": sentence[:SENTENCE_CHARACTERS_MAX]}
            for number, sentence in enumerate(not_carried[:SENTENCES_MAX])
        }
        return {**documents, **refusals}

    def _document(self, release: str, link: Link, values: Mapping[str, float], now_ms: int) -> dict[str, Any]:
        rate, seconds = self._rate(link, values[MESSAGES], now_ms)
        if rate == 0:
            since = self.before.time_ms if self.before else now_ms
            self.silent_since_ms.setdefault(link, since)
        else:
            self.silent_since_ms.pop(link, None)
        latency = values.get("latency_seconds")
        matched = values.get("matched_sources", values.get("matched_sinks"))
        return {
            **_link(release, *link),
            "rate_hz": rate,
            "over_seconds": seconds,
            "silent_since_ms": self.silent_since_ms.get(link),
            "latency_ms": None if latency is None else round(latency * 1000),
            "matched": None if matched is None else int(matched),
        }

    def _rate(self, link: Link, messages: float, now_ms: int) -> tuple[float | None, float | None]:
        """Messages a second since the reading before, to two digits, so that a steady link has a steady document; None
        without one, or when the bridge has begun to count anew."""
        if self.before is None or now_ms <= self.before.time_ms:
            return None, None
        counted = self.before.links.get(link, {}).get(MESSAGES)
        if counted is None or messages < counted:
            return None, None
        seconds = (now_ms - self.before.time_ms) / 1000
        return float(f"{(messages - counted) / seconds:.2g}"), round(seconds)


def unknown_links(documents: Mapping[str, Mapping[str, Any]], problem: str) -> dict[str, Any]:
    """The same links, of which nothing is known now, and why."""
    unknown = {"rate_hz": None, "over_seconds": None, "latency_ms": None, "matched": None, "problem": problem}
    return {key: {**document, **unknown} for key, document in documents.items()}


def _link(release: str, direction: str, topic: str) -> dict[str, Any]:
    return {
        "release": release,
        "agent": release.partition("/")[0],
        "direction": direction,
        "topic": topic,
        "rate_hz": None,
        "over_seconds": None,
        "silent_since_ms": None,
        "latency_ms": None,
        "matched": None,
        "problem": "",
    }
