"""The notification of an edge: the JSON document of webhooks, MQTT messages and installed reactions."""

from __future__ import annotations

import json

from robotkube.robots.rules.core import Edge
from robotkube.robots.rules.core.event_documents import edge_document

AGENTS = "{agents}"
CONTENT_TYPE = "application/json"


def delivery_id(edge: Edge) -> str:
    """The identifier of an edge's delivery, the same however often it is delivered."""
    return f"{edge.id}-{edge.edge}"


def notification(edge: Edge, detector: str, reason: str) -> bytes:
    """The document of an edge; times are ns since 1970. `reason` is the rule's, with the text `{agents}` in it."""
    document = edge_document(edge)
    details = {
        "id": delivery_id(edge),
        "event": edge.id,
        "detector": detector,
        "reason": reason.replace(AGENTS, ", ".join(edge.agents)),
    }
    return json.dumps({**document, **details}).encode()
