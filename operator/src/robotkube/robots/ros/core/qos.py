"""QoS profiles of ROS topics: those that publishers offer, those that subscriptions request, and how the two fit.

History is not announced in the graph and is no part of a profile. A duration of None is endless: nothing is promised or
requested.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

RELIABLE, BEST_EFFORT = "reliable", "best_effort"
VOLATILE, TRANSIENT_LOCAL = "volatile", "transient_local"
AUTOMATIC, MANUAL_BY_TOPIC = "automatic", "manual_by_topic"

RELIABILITIES = (RELIABLE, BEST_EFFORT)
DURABILITIES = (VOLATILE, TRANSIENT_LOCAL)
LIVELINESSES = (AUTOMATIC, MANUAL_BY_TOPIC)


class QosProfile(NamedTuple):
    """A QoS profile of a publisher or subscription. `deadline_ns`: the longest time between two messages; `lease_ns`:
    that between two signs of life."""

    reliability: str = RELIABLE
    durability: str = VOLATILE
    deadline_ns: int | None = None
    liveliness: str = AUTOMATIC
    lease_ns: int | None = None

    def text(self) -> str:
        """The profile in words, as status and log show it."""
        parts = [self.reliability, self.durability]
        if self.deadline_ns is not None:
            parts.append(f"deadline {self.deadline_ns / 1e9:g} s")
        if self.liveliness != AUTOMATIC or self.lease_ns is not None:
            lease = "" if self.lease_ns is None else f" {self.lease_ns / 1e9:g} s"
            parts.append(f"liveliness {self.liveliness}{lease}")
        return ", ".join(parts)


class PublisherOffer(NamedTuple):
    """A publisher in the graph: its node (empty while unknown), its message type and its QoS profile."""

    node: str
    type: str
    qos_profile: QosProfile


class IncompatiblePublishers(NamedTuple):
    """Publishers that the middleware did not connect: their number so far, and the policy that did not fit last."""

    publishers: int = 0
    policy: str = ""


class QosViolations(NamedTuple):
    """Violations of promises by connected publishers so far: deadlines that passed without a message, and times that
    one gave no sign of life for as long as its lease."""

    deadlines: int = 0
    liveliness: int = 0


class RequestedQos(NamedTuple):
    """The QoS that the settings request; a field that is None follows the publishers."""

    reliability: str | None = None
    durability: str | None = None
    deadline_ns: int | None = None
    liveliness: str | None = None
    lease_ns: int | None = None


def matching_profile(requested: RequestedQos, offers: Sequence[PublisherOffer]) -> QosProfile:
    """The strictest profile that all of the publishers meet, where the settings leave it open: the longest of the
    promised durations, and a strong kind only where each of them has it. Without publishers reliable and volatile."""
    offered = [offer.qos_profile for offer in offers]
    reliable = all(profile.reliability == RELIABLE for profile in offered)
    kept = bool(offered) and all(profile.durability == TRANSIENT_LOCAL for profile in offered)
    manual = bool(offered) and all(profile.liveliness == MANUAL_BY_TOPIC for profile in offered)
    return QosProfile(
        reliability=requested.reliability or (RELIABLE if reliable else BEST_EFFORT),
        durability=requested.durability or (TRANSIENT_LOCAL if kept else VOLATILE),
        deadline_ns=requested.deadline_ns or _longest([profile.deadline_ns for profile in offered]),
        liveliness=requested.liveliness or (MANUAL_BY_TOPIC if manual else AUTOMATIC),
        lease_ns=requested.lease_ns or _longest([profile.lease_ns for profile in offered]),
    )


def _longest(durations: Sequence[int | None]) -> int | None:
    finite = [duration for duration in durations if duration is not None]
    return max(finite) if finite and len(finite) == len(durations) else None


def mismatches(wanted: QosProfile, offer: QosProfile) -> Iterator[str]:
    """The policies in which a publisher offers less than a subscription requests, with both sides' values."""
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


def mismatch(type_name: str, wanted: QosProfile, offer: PublisherOffer) -> str:
    """The reason why a publisher's messages do not arrive, in one sentence; empty when they do."""
    problems = list(mismatches(wanted, offer.qos_profile))
    if offer.type != type_name:
        problems.insert(0, f"type: asked {type_name}, offered {offer.type}")
    if not problems:
        return ""
    return f"{offer.node or 'a publisher'} does not fit: {'; '.join(problems)}"


def _shorter(wanted: int | None, offered: int | None) -> bool:
    return wanted is not None and (offered is None or offered > wanted)


def _seconds(duration: int | None) -> str:
    return "endless" if duration is None else f"{duration / 1e9:g} s"
