"""Quality of service of ROS topics: what publishers offer, what a subscription asks for, and whether the two fit.

History is not announced by anybody and is no part of it. A duration of None is endless: nothing is promised or asked.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

RELIABLE, BEST_EFFORT = "reliable", "best_effort"
VOLATILE, TRANSIENT_LOCAL = "volatile", "transient_local"
AUTOMATIC, MANUAL_BY_TOPIC = "automatic", "manual_by_topic"

RELIABILITIES, DURABILITIES = (RELIABLE, BEST_EFFORT), (VOLATILE, TRANSIENT_LOCAL)
LIVELINESSES = (AUTOMATIC, MANUAL_BY_TOPIC)


class Quality(NamedTuple):
    """One side's settings. `deadline_ns`: the longest time between two messages; `lease_ns`: that between two signs of
    life."""

    reliability: str = RELIABLE
    durability: str = VOLATILE
    deadline_ns: int | None = None
    liveliness: str = AUTOMATIC
    lease_ns: int | None = None

    def text(self) -> str:
        """In words, as status and log show it."""
        parts = [self.reliability, self.durability]
        if self.deadline_ns is not None:
            parts.append(f"deadline {self.deadline_ns / 1e9:g} s")
        if self.liveliness != AUTOMATIC or self.lease_ns is not None:
            lease = "" if self.lease_ns is None else f" {self.lease_ns / 1e9:g} s"
            parts.append(f"liveliness {self.liveliness}{lease}")
        return ", ".join(parts)


class Offer(NamedTuple):
    """A publisher: its node (empty while unknown), its message type and its quality."""

    node: str
    type: str
    quality: Quality


class Incompatible(NamedTuple):
    """What the middleware said of publishers that it did not connect: how many so far, and the last one's policy."""

    publishers: int = 0
    policy: str = ""


class Broken(NamedTuple):
    """What connected publishers promised and did not keep: deadlines that passed without a message, and how often one
    gave no sign of life for as long as its lease; so many so far."""

    deadlines: int = 0
    liveliness: int = 0


class Asked(NamedTuple):
    """What the settings ask for; what is None is taken from the publishers."""

    reliability: str | None = None
    durability: str | None = None
    deadline_ns: int | None = None
    liveliness: str | None = None
    lease_ns: int | None = None


def matched(asked: Asked, offers: Sequence[Offer]) -> Quality:
    """The most that all of the publishers give, as far as the settings leave it open: the longest of the promised
    durations, and a strong kind only where each of them has it. Without publishers reliable and volatile."""
    offered = [offer.quality for offer in offers]
    kinds = [quality.liveliness for quality in offered]
    reliable = all(quality.reliability == RELIABLE for quality in offered)
    kept = bool(offered) and all(quality.durability == TRANSIENT_LOCAL for quality in offered)
    manual = bool(offered) and all(kind == MANUAL_BY_TOPIC for kind in kinds)
    return Quality(
        reliability=asked.reliability or (RELIABLE if reliable else BEST_EFFORT),
        durability=asked.durability or (TRANSIENT_LOCAL if kept else VOLATILE),
        deadline_ns=asked.deadline_ns or _longest([quality.deadline_ns for quality in offered]),
        liveliness=asked.liveliness or (MANUAL_BY_TOPIC if manual else AUTOMATIC),
        lease_ns=asked.lease_ns or _longest([quality.lease_ns for quality in offered]),
    )


def _longest(durations: Sequence[int | None]) -> int | None:
    finite = [duration for duration in durations if duration is not None]
    return max(finite) if finite and len(finite) == len(durations) else None


def mismatches(wanted: Quality, offer: Quality) -> Iterator[str]:
    """The settings in which a publisher does not give what a subscription asks for, with both sides' words."""
    if wanted.reliability == RELIABLE and offer.reliability != RELIABLE:
        yield f"reliability: asked {wanted.reliability}, offered {offer.reliability}"
    if wanted.durability == TRANSIENT_LOCAL and offer.durability != TRANSIENT_LOCAL:
        yield f"durability: asked {wanted.durability}, offered {offer.durability}"
    if _shorter(wanted.deadline_ns, offer.deadline_ns):
        yield f"deadline: asked {_seconds(wanted.deadline_ns)}, offered {_seconds(offer.deadline_ns)}"
    if wanted.liveliness == MANUAL_BY_TOPIC and offer.liveliness != MANUAL_BY_TOPIC:
        yield f"liveliness: asked {wanted.liveliness}, offered {offer.liveliness}"
    if _shorter(wanted.lease_ns, offer.lease_ns):
        yield f"liveliness lease: asked {_seconds(wanted.lease_ns)}, offered {_seconds(offer.lease_ns)}"


def mismatch(type_name: str, wanted: Quality, offer: Offer) -> str:
    """Why a publisher's messages do not come, in one sentence; empty when they do."""
    problems = list(mismatches(wanted, offer.quality))
    if offer.type != type_name:
        problems.insert(0, f"type: asked {type_name}, offered {offer.type}")
    if not problems:
        return ""
    return f"{offer.node or 'a publisher'} does not fit: {'; '.join(problems)}"


def _shorter(wanted: int | None, offered: int | None) -> bool:
    return wanted is not None and (offered is None or offered > wanted)


def _seconds(duration: int | None) -> str:
    return "endless" if duration is None else f"{duration / 1e9:g} s"
