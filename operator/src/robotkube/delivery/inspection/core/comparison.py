"""A workload of the cluster compared with what its release's chart renders.

Argo CD compares the other way: a field that its manifest does not name is nobody's business, so a container that
somebody appended stays, `Synced`. Here every field of the cluster's object must be explained: by the chart, by what the
API server fills in, or by a controller that is known to write it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robotkube.delivery.inspection.core.api_defaults import DEFAULTS
from robotkube.foundation.documents.core.quantities import quantity

Object = Mapping[str, Any]

DIFFERENCES_MAX = 5
VALUE_CHARACTERS_MAX = 80
OF_CONTROLLERS = frozenset(
    ["metadata.annotations.deployment.kubernetes.io/revision", "metadata.annotations.argocd.argoproj.io/tracking-id"]
)
"""What the Deployment controller and Argo CD write beside the chart."""
NOT_COMPARED = frozenset(["spec.replicas"])
"""How many pods of what was verified run is not whether they may."""
NAMES = ("name", "mountPath", "containerPort", "key")
"""Keys by which entries of a list are told apart, for the words of a difference."""
QUANTITIES = ("resources.limits", "resources.requests", "emptyDir", "divisor")
WORDS = ("labels", "annotations")  # an empty one says something
EMPTY: tuple[Any, ...] = (None, "", 0, False, [], {})


def differences(live: Object, rendered: Object) -> tuple[str, ...]:
    """What of a workload its chart does not explain, and what of the chart it has not: the first DIFFERENCES_MAX, a
    few words each. Status, owners and what the API server keeps for itself are not compared."""
    differing: list[str] = []
    for part in ("labels", "annotations"):
        place = f"metadata.{part}"
        differing += _compared(_metadata(live, part), _metadata(rendered, part), place, place)
    differing += _compared(live.get("spec"), rendered.get("spec"), "spec", "spec")
    return tuple(differing[:DIFFERENCES_MAX])


def differing_keys(live: Object, rendered: Object) -> tuple[str, ...]:
    """The keys of a ConfigMap that are not as its chart renders them: the first DIFFERENCES_MAX, with what is wrong.
    What they hold is not told."""
    differing: list[str] = []
    for part in ("data", "binaryData"):
        have, want = (one.get(part) or {} for one in (live, rendered))
        for key in sorted(have.keys() | want.keys()):
            if key not in want:
                differing.append(f"{part}.{key} is there, which the chart does not have")
            elif key not in have:
                differing.append(f"{part}.{key} is missing")
            elif have[key] != want[key]:
                differing.append(f"{part}.{key} says something else")
    return tuple(differing[:DIFFERENCES_MAX])


def _metadata(item: Object, part: str) -> Object:
    return dict((item.get("metadata") or {}).get(part) or {})


def _compared(live: Any, rendered: Any, place: str, words: str) -> Iterator[str]:
    """Differences at a place; `words` is the place as a person reads it, with names for entries of lists."""
    if place in NOT_COMPARED:
        return
    if isinstance(live, Mapping) and isinstance(rendered, Mapping):
        yield from _mappings(live, rendered, place, words)
    elif isinstance(live, list) and isinstance(rendered, list):
        yield from _lists(live, rendered, place, words)
    elif not _equal(live, rendered, place):
        yield f"{words} is {_short(live)}, not {_short(rendered)}"


def _mappings(live: Object, rendered: Object, place: str, words: str) -> Iterator[str]:
    for key in sorted({*live, *rendered}):
        inner = f"{place}.{key}"
        if key not in rendered:
            if not is_explained(live, key, inner):
                yield f"{words}.{key} is {_short(live[key])}, which the chart does not have"
        elif key not in live:
            if rendered[key] not in EMPTY and inner not in NOT_COMPARED:
                yield f"{words}.{key} is missing"
        else:
            yield from _compared(live[key], rendered[key], inner, f"{words}.{key}")


def is_explained(live: Object, key: str, place: str) -> bool:
    """Return whether a field that the chart does not name was filled in."""
    if place in OF_CONTROLLERS or place in NOT_COMPARED:
        return True
    if key == "serviceAccount":  # the former name of serviceAccountName, kept equal
        return bool(live[key] == live.get("serviceAccountName"))
    if place in DEFAULTS:
        return bool(live[key] == DEFAULTS[place])
    return (
        live[key] in EMPTY
        and not isinstance(live[key], (bool, int))
        and not place.removesuffix(f".{key}").endswith(WORDS)
    )


def _lists(live: Sequence[Any], rendered: Sequence[Any], place: str, words: str) -> Iterator[str]:
    if len(live) != len(rendered):
        known = [_name(entry) for entry in rendered]
        added = [_name(entry) for entry in live if _name(entry) not in known]
        gone = [name for name in known if name not in [_name(entry) for entry in live]]
        changed = [*(f"{name} added" for name in added), *(f"{name} missing" for name in gone)]
        yield f"{words} has {len(live)} entries, not {len(rendered)}" + (f" ({', '.join(changed)})" if changed else "")
        return
    for one, other in zip(live, rendered, strict=True):
        yield from _compared(one, other, f"{place}.*", f"{words}[{_name(one)}]")


def _name(entry: Any) -> str:
    if isinstance(entry, Mapping):
        return next((str(entry[key]) for key in NAMES if key in entry), _short(entry))
    return _short(entry)


def _equal(live: Any, rendered: Any, place: str) -> bool:
    if live == rendered or (live in EMPTY and rendered in EMPTY and not isinstance(live, (bool, int))):
        return isinstance(live, bool) == isinstance(rendered, bool)
    if any(part in place for part in QUANTITIES):
        amount = quantity(live)
        return amount is not None and amount == quantity(rendered)
    return False


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= VALUE_CHARACTERS_MAX else f"{text[:VALUE_CHARACTERS_MAX]}…"
