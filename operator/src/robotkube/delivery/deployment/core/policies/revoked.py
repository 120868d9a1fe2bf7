"""policies/revoked.yaml: agents that may not be at the broker, each with the reason.

    revoked:
    - {agent: vehicle-07, reason: its computer was stolen}

The process that keeps the broker's rights ends their connections, and lets none in until they stand here no more.
Without the file nobody is revoked. Always read from main.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robotkube.foundation.documents.core.patterns import NAME
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import read_mapping, write_mapping

PATH = "policies/revoked.yaml"
REASON_CHARACTERS_MAX = 200


def read_revoked(text: str, path: str = PATH) -> dict[str, str]:
    """Agent -> reason; DocumentError names the key and what may stand there."""
    reader = Reader(path)
    document = reader.mapping(read_mapping(text, path), "", [], ["revoked"])
    revoked: dict[str, str] = {}
    for index, item in enumerate(reader.sequence(document.get("revoked"), "revoked")):
        where = f"revoked[{index}]"
        entry = reader.mapping(item, where, ["agent", "reason"])
        agent = reader.word(entry.get("agent"), f"{where}.agent", NAME)
        if agent in revoked:
            reader.problems.append(f"{where}.agent: {agent} stands twice; keep one of them")
        revoked[agent] = _reason(reader, entry.get("reason"), f"{where}.reason")
    reader.finish()
    return revoked


def write_revoked(revoked: Mapping[str, str]) -> str:
    """The text of the file, sorted by agent."""
    entries = [{"agent": agent, "reason": reason} for agent, reason in sorted(revoked.items())]
    return write_mapping({"revoked": entries})


def _reason(reader: Reader, value: Any, path: str) -> str:
    if isinstance(value, str) and value.strip() and value.isprintable() and len(value) <= REASON_CHARACTERS_MAX:
        return value
    if value is not None:  # else it is missing, which is said already
        reader.problems.append(f"{path}: must be one line of 1 to {REASON_CHARACTERS_MAX} characters")
    return ""
