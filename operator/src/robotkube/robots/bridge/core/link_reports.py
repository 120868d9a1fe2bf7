"""A bridge's report of links that it does not carry: what cannot be seen in its pod, which goes on for other links.

It is the retained MQTT message `robotkube/links/<agent>/<release>` with the JSON object `{"pod": "<name>", "started":
"<ns since 1970>", "notCarried": [{"direction": "out", "topic": "/x", "reason": "..."}]}`; an empty message, or none:
everything is carried, as far as the bridge knows. It is believed while the process that sent it runs.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.patterns import NAME, ROS_TOPIC_PATTERN, SUBDOMAIN
from robotkube.foundation.documents.core.reader import Reader

LINKS_TOPIC = "robotkube/links/"
PAYLOAD_BYTES_MAX = 32 * 1024
REASON_CHARACTERS_MAX = 300
LINKS_MAX = 100

_DIRECTION = re.compile("out|in")
_NANOSECONDS = re.compile("[0-9]{1,19}", re.ASCII)


@dataclass(frozen=True)
class LinkFault:
    """A topic that a bridge does not carry: `out` to the broker or `in` from there, by its ROS name in the bridge's
    settings, and why."""

    direction: str
    topic: str
    reason: str


@dataclass(frozen=True)
class LinkReport:
    """What the bridge `release` (its key) does not carry; `pod` and `started_ns` (ns since 1970, by its machine's
    clock) say which process says so."""

    release: str
    pod: str
    started_ns: int
    faults: tuple[LinkFault, ...]


def report_document(pod: str, started_ns: int, faults: Iterable[LinkFault]) -> Mapping[str, Any]:
    """The report as JSON has it; the first LINKS_MAX faults."""
    listed = [
        {"direction": fault.direction, "topic": fault.topic, "reason": fault.reason[:REASON_CHARACTERS_MAX]}
        for fault in faults
    ]
    return {"pod": pod, "started": str(started_ns), "notCarried": listed[:LINKS_MAX]}


def report_release(namespaces: Mapping[str, str], topic: str) -> str:
    """The key of the release that a report's topic is about, by the namespaces of agents; empty when it is none's."""
    agent, _, release = topic.removeprefix(LINKS_TOPIC).partition("/")
    return f"{namespaces[agent]}/{release}" if agent in namespaces and NAME.fullmatch(release) else ""


def read_report(release: str, payload: bytes, size: int) -> LinkReport | None:
    """The report in a message of `size` bytes; None when it is empty. DocumentError names every problem."""
    where = f"links of {release}"
    if not size:
        return None
    if size > PAYLOAD_BYTES_MAX:
        raise DocumentError(where, [f"{size} bytes; at most {PAYLOAD_BYTES_MAX} are read"])
    try:
        document = read_json(payload.decode())
    except ValueError as error:
        raise DocumentError(where, [f"not readable as JSON: {error}"]) from error
    reader = Reader(where)
    values = reader.mapping(document, "", ["pod", "started", "notCarried"])
    pod = reader.word(values.get("pod"), "pod", SUBDOMAIN)
    started = reader.word(values.get("started"), "started", _NANOSECONDS)
    listed = reader.sequence(values.get("notCarried"), "notCarried")
    if len(listed) > LINKS_MAX:
        reader.problems.append(f"notCarried: {len(listed)} links; at most {LINKS_MAX} are read")
    faults = tuple(_fault(reader, one, f"notCarried[{index}]") for index, one in enumerate(listed[:LINKS_MAX]))
    reader.finish()
    return LinkReport(release, pod, int(started), faults)


def _fault(reader: Reader, value: Any, path: str) -> LinkFault:
    fault = reader.mapping(value, path, ["direction", "topic", "reason"])
    return LinkFault(
        reader.word(fault.get("direction"), f"{path}.direction", _DIRECTION),
        reader.word(fault.get("topic"), f"{path}.topic", ROS_TOPIC_PATTERN),
        reader.prose(fault.get("reason"), f"{path}.reason")[:REASON_CHARACTERS_MAX],
    )
