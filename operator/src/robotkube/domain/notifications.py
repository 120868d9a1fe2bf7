"""An edge as others are told of it: the JSON document of webhooks, MQTT messages and installed reactions."""

from __future__ import annotations

import json

from robotkube.domain.rules import Edge
from robotkube.domain.rules.documents import edge_document

AGENTS = "{agents}"
CONTENT_TYPE = "application/json"


def delivery_id(edge: Edge) -> str:
    """The same for the same edge, however often it is told."""
    return f"{edge.id}-{edge.edge}"


def notification(edge: Edge, detector: str, reason: str) -> bytes:
    """The document; times are ns since 1970. `reason` is the rule's, with the text `{agents}` in it."""
    found = edge_document(edge)
    told = {
        "id": delivery_id(edge),
        "event": edge.id,
        "detector": detector,
        "reason": reason.replace(AGENTS, ", ".join(edge.agents)),
    }
    return json.dumps({**found, **told}).encode()
