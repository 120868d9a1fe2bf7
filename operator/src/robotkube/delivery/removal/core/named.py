"""Inspections as the remover reads them: the strangers that one names, and whether they may be believed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.inspection.core.statuses import PARTLY_SEEN, SEEN, strangers_of
from robotkube.delivery.inspection.core.strangers import Stranger
from robotkube.foundation.documents.core.times import time_ns

AGE_SECONDS_MAX = 150  # an inspector writes at least every 60 s
SKEW_SECONDS_MAX = 60  # of the clocks of two machines

Object = Mapping[str, Any]


@dataclass(frozen=True)
class NamedStrangers:
    """What one Inspection names. `seen_ns`: when the look was that saw it; None when the last look saw nothing.
    `condition`: what the remover said of it before, empty when nothing."""

    name: str
    uid: str
    looks_at: str
    seen_ns: int | None
    strangers: tuple[Stranger, ...]
    condition: Object

    def is_believed(self, now_ns: int) -> bool:
        """Return whether the look is young enough to act on. One from the future is not: a clock is wrong."""
        if self.seen_ns is None:
            return False
        age = now_ns - self.seen_ns
        return -SKEW_SECONDS_MAX * 10**9 <= age <= AGE_SECONDS_MAX * 10**9


def read_inspection(document: Object, removed: str) -> NamedStrangers:
    """An Inspection as the API has it; `removed` is the type of the remover's own condition."""
    metadata = document.get("metadata") or {}
    status = document.get("status") or {}
    conditions = {str(one.get("type")): one for one in status.get("conditions") or ()}
    return NamedStrangers(
        name=str(metadata.get("name", "")),
        uid=str(metadata.get("uid", "")),
        looks_at=str((document.get("spec") or {}).get("looksAt", "")),
        seen_ns=_time(status) if _is_seen(conditions.get(SEEN, {})) else None,
        strangers=strangers_of(status),
        condition=conditions.get(removed, {}),
    )


def _is_seen(condition: Object) -> bool:
    """Return whether what is named was seen, if not everything was."""
    return condition.get("status") == "True" or condition.get("reason") == PARTLY_SEEN


def _time(status: Object) -> int | None:
    try:
        return time_ns(str(status.get("observedTime", "")))
    except ValueError:
        return None
