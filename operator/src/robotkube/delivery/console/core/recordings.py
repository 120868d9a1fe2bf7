"""The documents of recordings, out of pages of event detectors: windows, counts and gaps as the recorder says them.

What a database and volumes hold of them the command line says (`robotkube recording show`, `verify`, `export`): the
console has no account there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robotkube.delivery.console.core.moments import ns_ms

GAPS_MAX = 50
COUNTS = ("received", "stored", "early", "duplicates", "dropped")

Object = Mapping[str, Any]


def recording_documents(page: Object, namespace: str, detector: str) -> dict[str, dict[str, Any]]:
    """The items of a detector's page /recordings, of an agent's namespace."""
    return {
        f"{namespace}/{recording['recording']}": _recording(recording, namespace, detector)
        for recording in page["recordings"]
    }


def _recording(recording: Object, namespace: str, detector: str) -> dict[str, Any]:
    topics = [_topic(audit) for audit in sorted(recording["topics"], key=lambda audit: str(audit["topic"]))]
    gaps = [gap for audit in recording["topics"] for gap in _gaps(audit)]
    provenance: Object = recording.get("provenance") or {}  # a detector of an older version says nothing of it
    return {
        "recording": str(recording["recording"]),
        "agent": namespace,
        "rule": str(recording["rule"]),
        "task": str(provenance.get("task") or ""),
        "event": str(provenance.get("event") or ""),
        "detector": detector,
        "volume": str(recording["volume"]),
        "at_work": recording["ended"] is None,
        "began_ms": ns_ms(recording["began"]),
        "ended_ms": ns_ms(recording["ended"]),
        "windows": [_window(cause) for cause in recording["causes"]],
        "topics": topics,
        **{name: sum(topic[name] for topic in topics) for name in COUNTS},
        "gap_count": len(gaps),
        "gaps": sorted(gaps, key=lambda gap: (gap["first_ms"] or 0, gap["topic"]))[:GAPS_MAX],
    }


def _window(cause: Object) -> dict[str, Any]:
    """The event that a window is for: `event` is its id."""
    return {
        "event": str(cause["event"]),
        "agents": list(cause.get("agents") or ()),
        "began_ms": ns_ms(cause["started"]),
        "ended_ms": ns_ms(cause["stopped"]),
    }


def _topic(audit: Object) -> dict[str, Any]:
    window: Sequence[Any] = audit.get("window") or (None, None)
    return {
        "topic": str(audit["topic"]),
        "first_ms": ns_ms(window[0]),
        "last_ms": ns_ms(window[1]),
        **{name: int(audit[name]) for name in COUNTS},
        "gap_count": len(audit["gaps"]),
    }


def _gaps(audit: Object) -> Iterator[dict[str, Any]]:
    for gap in audit["gaps"]:
        yield {
            "topic": str(audit["topic"]),
            "where": str(gap["where"]),
            "why": str(gap["why"]),
            "count": gap["count"],
            "first_ms": ns_ms(gap["first"]),
            "last_ms": ns_ms(gap["last"]),
        }
