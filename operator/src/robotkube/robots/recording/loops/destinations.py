"""The destination of a recording, and the bounds on the way to it."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from robotkube.foundation.runtime.loops.fencing import Fencing

if TYPE_CHECKING:
    from robotkube.robots.recording.ports import RecordingStore, WritableVolume

ROUND_SECONDS = 0.25
QUEUE_BYTES_MAX = 256 * 1024 * 1024
WAITING_BYTES_MAX = 64 * 1024 * 1024
SPOOL_BYTES_MAX = 1024 * 1024 * 1024


@dataclass(frozen=True)
class RecorderPlace:
    """The destination of a recorder. The openers are called on threads of the recording, so that importing and
    connecting do not delay the subscriptions; `volume` is `<node>/<volume claim>`. While the release is fenced
    (`fencing` is not sure), nothing is written to the database. `draw`: so many random bytes, for keys."""

    volume: str
    open_store: Callable[[], RecordingStore]
    open_volume_claim: Callable[[], WritableVolume]
    clock_ns: Callable[[], int]
    monotonic: Callable[[], float]
    fencing: Fencing = field(default_factory=Fencing)
    draw: Callable[[int], bytes] = secrets.token_bytes


@dataclass(frozen=True)
class RecordingBounds:
    """Bounds of what waits: messages in a recording's queue; writes in memory before they are spooled; the spool.

    When the volume refuses the spool, writes of twice `waiting_bytes` wait in memory, then the oldest are dropped."""

    queue_bytes: int = QUEUE_BYTES_MAX
    waiting_bytes: int = WAITING_BYTES_MAX
    spool_bytes: int = SPOOL_BYTES_MAX


BOUNDS = RecordingBounds()
