"""A device's veto: an agent that says `driving` keeps what runs on it until it parks, bounded by an expiry.

Two ways to say it: on the agent's Node, label or annotation `robotkube.io/hold=<reason>` with the annotation
`robotkube.io/hold-until=<RFC 3339 time>`, or the retained MQTT message `robotkube/holds/<agent>` with the JSON object
`{"reason": "driving", "until": "<RFC 3339 time>"}`; an empty message, or none, releases. On a Node the expiry may be
left out: then the hold ends HOLD_SECONDS_MAX after it was set. No hold lasts longer than that unless it is said anew.

Held are all changes of releases on the agent, removals too: what stops a service in motion is as much a surprise as
what starts one. A release that moves away from a held agent is held at both ends, so that it never runs twice.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from robotkube.domain.errors import DocumentError
from robotkube.domain.planning import ADD, REMOVE, Change
from robotkube.domain.releases import Release

HOLD_SECONDS_MAX = 4 * 3600
PAYLOAD_BYTES_MAX = 4096
REASON_CHARACTERS_MAX = 100
HOLD, UNTIL = "robotkube.io/hold", "robotkube.io/hold-until"
HOLDS_TOPIC = "robotkube/holds/"


@dataclass(frozen=True, order=True)
class Hold:
    """Agent `agent` wants no change until `until_ns` (ns since 1970), and why."""

    agent: str
    until_ns: int
    reason: str

    @property
    def text(self) -> str:
        """As conditions say it."""
        moment = datetime.fromtimestamp(self.until_ns // 1_000_000_000, UTC)
        return f"{self.agent} holds changes until {moment:%Y-%m-%dT%H:%M:%SZ}: {self.reason}"


def node_hold(agent: str, metadata: Mapping[str, Any]) -> Hold | None:
    """The hold that a Node's metadata states; None when it states none. A `hold-until` that cannot be read counts as
    left out: a device that wanted to be left alone is."""
    labels, annotations = metadata.get("labels") or {}, metadata.get("annotations") or {}
    reason = annotations.get(HOLD) or labels.get(HOLD)
    if not reason:
        return None
    latest = _set_at(metadata) + HOLD_SECONDS_MAX * 1_000_000_000
    stated = _time_ns(annotations.get(UNTIL))
    return Hold(agent, latest if stated is None else min(stated, latest), _bounded(str(reason)))


def _set_at(metadata: Mapping[str, Any]) -> int:
    """When somebody last wrote the hold, as the API server's own record says; the Node's creation when it does not."""
    times = []
    for entry in metadata.get("managedFields") or []:
        owned = (entry.get("fieldsV1") or {}).get("f:metadata") or {}
        fields = {**(owned.get("f:labels") or {}), **(owned.get("f:annotations") or {})}
        if f"f:{HOLD}" in fields or f"f:{UNTIL}" in fields:
            times.append(_time_ns(entry.get("time")) or 0)
    return max(times, default=_time_ns(metadata.get("creationTimestamp")) or 0)


def message_hold(agent: str, payload: bytes, received_ns: int) -> Hold | None:
    """The hold in a retained message of `agent`; None when it is empty (released). DocumentError when it cannot be
    read: the caller says so and keeps what it had. `until` is needed: a message does not tell when it was sent."""
    if not payload:
        return None
    where = f"{HOLDS_TOPIC}{agent}"
    if len(payload) > PAYLOAD_BYTES_MAX:
        raise DocumentError(where, [f"{len(payload)} bytes, at most {PAYLOAD_BYTES_MAX} are read"])
    try:
        found = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise DocumentError(where, ['must be a JSON object such as {"reason": "driving", "until": "..."}']) from error
    reason, until = (found.get("reason"), found.get("until")) if isinstance(found, dict) else (None, None)
    stated = _time_ns(until)
    problems = [] if isinstance(reason, str) and reason else ["reason: must be text, such as driving"]
    problems += [] if stated is not None else ["until: must be an RFC 3339 time, such as 2026-11-21T10:00:00Z"]
    if problems or stated is None:
        raise DocumentError(where, problems)
    return Hold(agent, min(stated, received_ns + HOLD_SECONDS_MAX * 1_000_000_000), _bounded(str(reason)))


def _time_ns(text: Any) -> int | None:
    try:
        moment = datetime.fromisoformat(text)
        return int((moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()) * 1_000_000_000
    except (ValueError, TypeError, OverflowError):
        return None


def _bounded(reason: str) -> str:
    plain = "".join(c if c.isprintable() else " " for c in reason)
    return plain[:REASON_CHARACTERS_MAX]


def standing(holds: Iterable[Hold], now_ns: int) -> dict[str, Hold]:
    """The hold of each agent that lasts: of several (two Nodes, Node and message) the one that ends last."""
    return {hold.agent: hold for hold in sorted(holds) if hold.until_ns > now_ns}


def held(
    changes: Sequence[Change], holds: Iterable[Hold], agents: Mapping[str, str], now_ns: int
) -> tuple[tuple[Change, ...], dict[str, Hold]]:
    """The changes that may be made now, and the hold of each that waits, by path. `agents` is namespace -> agent."""
    lasting = standing(holds, now_ns)
    waiting = {c.path: lasting[agent] for c in changes if (agent := agents.get(c.release.namespace, "")) in lasting}
    leaving = [change for change in changes if change.kind == REMOVE and change.path in waiting]
    for change in changes:
        origin = next((left for left in leaving if change.kind == ADD and _moves(left, change)), None)
        if origin is not None:
            waiting.setdefault(change.path, waiting[origin.path])
    return tuple(c for c in changes if c.path not in waiting), waiting


def _moves(left: Change, added: Change) -> bool:
    """Whether `added` is the release that goes with `left`, on another agent: nothing else differs."""
    before, after = left.release, added.release
    return (before.name, before.chart, _anywhere(before)) == (after.name, after.chart, _anywhere(after))


def _anywhere(release: Release) -> dict[str, Any]:
    return {key: value for key, value in release.values.items() if key != "placement"}


def waiting_tasks(changes: Iterable[Change], waiting: Mapping[str, Hold]) -> dict[str, str]:
    """Task -> what it waits for, in words, of all tasks whose demand on a release would begin, end or change."""
    texts: dict[str, list[str]] = {}
    for change in changes:
        if change.path in waiting:
            before, after = (set(side.causes) if side else set() for side in (change.before, change.after))
            for task in {cause.task for cause in before ^ after}:
                texts.setdefault(task, []).append(f"{change.release.key}: {waiting[change.path].text}")
    return {task: "; ".join(sorted(lines)) for task, lines in texts.items()}
