"""Where a recording goes, and the bounds on the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from robotkube.services.ownership import Ownership

if TYPE_CHECKING:
    from robotkube.ports.recordings import Claim, RecordingStore

ROUND_SECONDS = 0.25
QUEUE_BYTES_MAX = 256 * 1024 * 1024
WAITING_BYTES_MAX = 64 * 1024 * 1024
SPOOL_BYTES_MAX = 1024 * 1024 * 1024


@dataclass(frozen=True)
class RecorderPlace:
    """Where a recorder stores. The openers are called on threads of the recording, so that importing and connecting do
    not delay the subscriptions; `volume` is `<node>/<claim>`. While `ownership` is not sure, nothing is written to the
    database."""

    volume: str
    open_store: Callable[[], RecordingStore]
    open_claim: Callable[[], Claim]
    clock_ns: Callable[[], int]
    monotonic: Callable[[], float]
    ownership: Ownership = field(default_factory=Ownership)


@dataclass(frozen=True)
class RecordingBounds:
    """What may wait: messages in a recording's queue; writes in memory before they are spooled; the spool on the claim.

    When the volume refuses the spool, writes of twice `waiting_bytes` wait in memory, then the oldest are dropped."""

    queue_bytes: int = QUEUE_BYTES_MAX
    waiting_bytes: int = WAITING_BYTES_MAX
    spool_bytes: int = SPOOL_BYTES_MAX


BOUNDS = RecordingBounds()
