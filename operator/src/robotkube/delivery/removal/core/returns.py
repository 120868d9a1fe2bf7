"""Returns: what comes again after it was taken away, and how long the remover waits for each next time.

Whoever makes a stranger may make it again at once. Taken away at once as well, two processes would keep a machine busy
with nothing else. So each maker has pauses of its own, which grow.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from robotkube.backoffs import Random, backoff

PAUSE_SECONDS_MIN = 5.0
PAUSE_SECONDS_MAX = 300.0
FORGET_SECONDS = 1800.0  # longer than any pause: who is quiet for so long begins anew
REPLICA_SET, DEPLOYMENT, POD = "ReplicaSet", "Deployment", "Pod"
HASH_LABEL = "pod-template-hash"
MINUTE_SECONDS = 60.0


@dataclass(frozen=True, order=True)
class Maker:
    """What makes a stranger: the workload that a pod is of, or the pod itself when it is of none."""

    namespace: str
    kind: str
    name: str

    def __str__(self) -> str:
        return f"{self.kind} {self.namespace}/{self.name}"


def maker_of(pod: Mapping[str, Any]) -> Maker:
    """The workload of a pod: of a ReplicaSet's the Deployment, which its name begins with."""
    metadata = pod["metadata"]
    namespace = str(metadata["namespace"])
    owner = next((one for one in metadata.get("ownerReferences") or () if one.get("controller")), None)
    if owner is None:
        return Maker(namespace, POD, str(metadata["name"]))
    kind, name = str(owner["kind"]), str(owner["name"])
    suffix = "-" + str((metadata.get("labels") or {}).get(HASH_LABEL, ""))
    if kind == REPLICA_SET and len(suffix) > 1 and name.endswith(suffix):
        return Maker(namespace, DEPLOYMENT, name.removesuffix(suffix))
    return Maker(namespace, kind, name)


@dataclass(frozen=True)
class _Removals:
    """How often something of one maker was taken away, when last, and when it may be again (seconds of one clock)."""

    count: int
    last: float
    next: float


@dataclass
class Returns:
    """The removals so far, by what was done (`act`, a word) and whose it was. Times are seconds of a clock that never
    goes back; of all together at most `per_minute`."""

    random: Random
    per_minute: int
    _known: dict[tuple[str, Maker], _Removals] = field(default_factory=dict)
    _recent: list[float] = field(default_factory=list)

    def count(self, act: str, maker: Maker) -> int:
        """How often."""
        known = self._known.get((act, maker))
        return known.count if known else 0

    def since(self, act: str, maker: Maker, now: float) -> float:
        """Seconds since the last time; infinite when there was none."""
        known = self._known.get((act, maker))
        return now - known.last if known else float("inf")

    def is_due(self, act: str, maker: Maker, now: float) -> bool:
        """Whether its pause is over; it has none within one turn, at one time `now`."""
        known = self._known.get((act, maker))
        return known is None or now >= known.next or now == known.last

    def is_full(self, now: float) -> bool:
        """Whether so much was taken away in the last minute that something else must be wrong."""
        self._recent = [at for at in self._recent if now - at < MINUTE_SECONDS]
        return len(self._recent) >= self.per_minute

    def note(self, act: str, maker: Maker, now: float) -> None:
        """It is taken away now. What belongs to one maker and goes in one turn counts once for its pauses."""
        self._recent.append(now)
        known = self._known.get((act, maker))
        if known is not None and known.last == now:
            return
        count = known.count + 1 if known else 1
        pause = PAUSE_SECONDS_MIN + backoff(
            count - 1, PAUSE_SECONDS_MIN, PAUSE_SECONDS_MAX - PAUSE_SECONDS_MIN, self.random
        )
        self._known[act, maker] = _Removals(count, now, now + pause)

    def forget(self, now: float) -> None:
        """Forget who was quiet for FORGET_SECONDS."""
        self._known = {key: one for key, one in self._known.items() if now - one.last < FORGET_SECONDS}

    def coming_again(self) -> int:
        """How many makers made something again that had been taken away."""
        return len({maker for (_, maker), one in self._known.items() if one.count > 1})
