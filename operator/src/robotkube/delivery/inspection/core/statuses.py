"""The status of an Inspection: what a look saw, with the times that the status before has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.delivery.inspection.core.strangers import API_VERSION, KIND, Look, Stranger

STRANGERS_MAX = 50
NAMED_MAX = 5  # strangers in a condition's message
MESSAGE_CHARACTERS_MAX = 1000
SEEN, CLEAN = "Seen", "Clean"
OWN = (SEEN, CLEAN)
"""The conditions of who looks. Others may write conditions of their own beside them."""
LOOKED, NOT_SEEN, PARTLY_SEEN = "Looked", "NotSeen", "PartlySeen"
ALL_KNOWN, STRANGERS = "AllKnown", "Strangers"

Status = Mapping[str, Any]


def manifest(look: Look, namespace: str) -> dict[str, Any]:
    """The Inspection of a look, without its status."""
    spec = {"looksAt": look.looks_at} | ({"node": look.node} if look.node else {})
    return {
        "apiVersion": API_VERSION,
        "kind": KIND,
        "metadata": {"name": look.name, "namespace": namespace},
        "spec": spec,
    }


def status_of(look: Look, before: Status, now: str) -> dict[str, Any]:
    """The status after a look at time `now` (RFC 3339). Nothing was seen: the strangers of the status before stay,
    since they were not seen to go, and Clean is Unknown."""
    if look.problem:
        kept = {key: before[key] for key in ("observedTime", "strangers", "strangersTotal") if key in before}
        return {**kept, "conditions": _conditions(look, before, now)}
    since = {_key(entry): entry.get("since", now) for entry in before.get("strangers") or ()}
    ordered = sorted(look.strangers)
    return {
        "observedTime": now,
        "strangers": [_entry(one, since.get(one.key, now)) for one in ordered[:STRANGERS_MAX]],
        "strangersTotal": len(ordered),
        "conditions": _conditions(look, before, now),
    }


def own(status: Status) -> dict[str, Any]:
    """The status without what others wrote into it."""
    conditions = {str(one.get("type")): one for one in status.get("conditions") or ()}
    kept = [conditions[kind] for kind in OWN if kind in conditions]
    return {**status, "conditions": kept} if "conditions" in status else dict(status)


def look_of(name: str, status: Status) -> Look:
    """The look at a place of one node that a status says, by the name of its Inspection."""
    looks_at, _, node = name.partition(".")
    seen: Status = next((one for one in status.get("conditions") or () if one.get("type") == SEEN), {})
    problem = "" if seen.get("status") == "True" else str(seen.get("message") or "nobody looked yet")
    return Look(looks_at, () if problem else strangers_of(status), node, problem)


def strangers_of(status: Status) -> tuple[Stranger, ...]:
    """The strangers that a status lists."""
    return tuple(map(_stranger, status.get("strangers") or ()))


def _stranger(entry: Mapping[str, Any]) -> Stranger:
    words = ("kind", "namespace", "name", "reason", "message", "container", "image", "digest", "uid")
    return Stranger(
        **{word: str(entry.get(word, "")) for word in words},
        generation=int(entry.get("generation") or 0),
        excess=tuple(map(str, entry.get("excess") or ())),
    )


def _key(entry: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(str(entry.get(key, "")) for key in ("kind", "namespace", "name", "container", "reason"))


def _entry(one: Stranger, since: str) -> dict[str, Any]:
    words = {"kind": one.kind, "namespace": one.namespace, "name": one.name, "container": one.container}
    words |= {"image": one.image, "digest": one.digest, "reason": one.reason, "uid": one.uid}
    given: dict[str, Any] = {key: word for key, word in words.items() if word or key in ("namespace", "name")}
    if one.excess:
        given |= {"generation": one.generation, "excess": list(one.excess)}
    return {**given, "message": one.message[:MESSAGE_CHARACTERS_MAX], "since": since}


def _conditions(look: Look, before: Status, now: str) -> list[dict[str, str]]:
    seen = (SEEN, "True", LOOKED, "looked")
    clean = (CLEAN, "True", ALL_KNOWN, "no strangers")
    if look.problem:
        seen = (SEEN, "False", NOT_SEEN, look.problem)
        clean = (CLEAN, "Unknown", NOT_SEEN, "nothing could be looked at, so nothing is claimed")
    elif look.partly:
        seen = (SEEN, "False", PARTLY_SEEN, look.partly)
        clean = (CLEAN, "Unknown", PARTLY_SEEN, "no strangers in what could be looked at")
    if look.strangers:
        clean = (CLEAN, "False", STRANGERS, named(look.strangers))
    return [_condition(*entry, before=before, now=now) for entry in (seen, clean)]


def named(strangers: Sequence[Stranger]) -> str:
    """The first strangers by name, and how many more there are."""
    first = ", ".join(f"{stranger} ({stranger.reason})" for stranger in sorted(strangers)[:NAMED_MAX])
    more = len(strangers) - NAMED_MAX
    return f"{first} and {more} more" if more > 0 else first


def _condition(kind: str, state: str, reason: str, message: str, before: Status, now: str) -> dict[str, str]:
    earlier: Status = next((c for c in before.get("conditions") or () if c.get("type") == kind), {})
    changed = now if earlier.get("status") != state else str(earlier.get("lastTransitionTime", now))
    text = message[:MESSAGE_CHARACTERS_MAX]
    return {"type": kind, "status": state, "reason": reason, "message": text, "lastTransitionTime": changed}
