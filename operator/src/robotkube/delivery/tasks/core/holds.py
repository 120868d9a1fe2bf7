"""A device's hold: an agent that is `driving` keeps what runs on it until it parks, bounded by an expiry.

It is set in one of two ways: on the agent's Node, label or annotation `robotkube.io/hold=<reason>` with the annotation
`robotkube.io/hold-until=<RFC 3339 time>`, or the retained MQTT message `robotkube/holds/<agent>` with the JSON object
`{"reason": "driving", "until": "<RFC 3339 time>"}`; an empty message, or none, releases. On a Node the expiry may be
left out: then the hold ends HOLD_SECONDS_MAX after it was set. No hold lasts longer than that unless it is set anew.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.json_codec import read_json

HOLD_SECONDS_MAX = 4 * 3600
PAYLOAD_BYTES_MAX = 4096
REASON_CHARACTERS_MAX = 100
HOLD = "robotkube.io/hold"
UNTIL = "robotkube.io/hold-until"
HOLDS_TOPIC = "robotkube/holds/"


@dataclass(frozen=True, order=True)
class DeviceHold:
    """A hold on changes: agent `agent` wants none until `until_ns` (ns since 1970), for `reason`."""

    agent: str
    until_ns: int
    reason: str

    @property
    def text(self) -> str:
        """The hold in the words of a condition."""
        moment = datetime.fromtimestamp(self.until_ns // 1_000_000_000, UTC)
        return f"{self.agent} holds changes until {moment:%Y-%m-%dT%H:%M:%SZ}: {self.reason}"


def node_hold(agent: str, metadata: Mapping[str, Any]) -> DeviceHold | None:
    """The hold that a Node's metadata states; None when it states none. A `hold-until` that cannot be read counts as
    left out: a device that wanted to be left alone is."""
    labels = metadata.get("labels") or {}
    annotations = metadata.get("annotations") or {}
    reason = annotations.get(HOLD) or labels.get(HOLD)
    if not reason:
        return None
    latest = _set_at(metadata) + HOLD_SECONDS_MAX * 1_000_000_000
    stated = _time_ns(annotations.get(UNTIL))
    return DeviceHold(agent, latest if stated is None else min(stated, latest), _bounded(str(reason)))


def _set_at(metadata: Mapping[str, Any]) -> int:
    """The time (ns since 1970) at which the hold was last written, by the API server's own record; else the Node's
    creation."""
    times = []
    for entry in metadata.get("managedFields") or []:
        owned = (entry.get("fieldsV1") or {}).get("f:metadata") or {}
        keys = {**(owned.get("f:labels") or {}), **(owned.get("f:annotations") or {})}
        if f"f:{HOLD}" in keys or f"f:{UNTIL}" in keys:
            times.append(_time_ns(entry.get("time")) or 0)
    return max(times, default=_time_ns(metadata.get("creationTimestamp")) or 0)


def message_hold(agent: str, payload: bytes, received_ns: int) -> DeviceHold | None:
    """The hold in a retained message of `agent`; None when it is empty (released). DocumentError when it cannot be
    read: the caller logs it and keeps what it had. `until` is needed: a message does not say when it was sent."""
    if not payload:
        return None
    where = f"{HOLDS_TOPIC}{agent}"
    if len(payload) > PAYLOAD_BYTES_MAX:
        raise DocumentError(where, [f"{len(payload)} bytes, at most {PAYLOAD_BYTES_MAX} are read"])
    try:
        document = read_json(payload)
    except ValueError as error:
        raise DocumentError(where, ['must be a JSON object such as {"reason": "driving", "until": "..."}']) from error
    message = document if isinstance(document, dict) else {}
    reason = message.get("reason")
    stated = _time_ns(message.get("until"))
    problems = [] if isinstance(reason, str) and reason else ["reason: must be text, such as driving"]
    problems += [] if stated is not None else ["until: must be an RFC 3339 time, such as 2026-11-21T10:00:00Z"]
    if problems or stated is None:
        raise DocumentError(where, problems)
    return DeviceHold(agent, min(stated, received_ns + HOLD_SECONDS_MAX * 1_000_000_000), _bounded(str(reason)))


def _time_ns(text: Any) -> int | None:
    try:
        moment = datetime.fromisoformat(text)
        return int((moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()) * 1_000_000_000
    except (ValueError, TypeError, OverflowError):
        return None


def _bounded(reason: str) -> str:
    plain = "".join(c if c.isprintable() else " " for c in reason)
    return plain[:REASON_CHARACTERS_MAX]
