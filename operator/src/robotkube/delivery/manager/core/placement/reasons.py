"""Reasons of placement in words: one for each candidate, or, where there are many, one for each kind."""

from __future__ import annotations

from collections.abc import Sequence

LISTED_MAX = 10  # candidates that are listed one by one; more are counted by reason
NAMED_MAX = 5
DECLARED = "values `agents` of the chart robotkube"  # where agents are declared

Reason = tuple[str, str]
"""Why a candidate is chosen or not: what many have in common, and the rest of the sentence."""


def listed(reasons: Sequence[tuple[str, Reason]]) -> tuple[str, ...]:
    """A sentence per candidate, or, for many, one per kind of reason with their number and the first names."""
    if len(reasons) <= LISTED_MAX:
        return tuple(f"{name}: {kind}{rest}" for name, (kind, rest) in reasons)
    kinds: dict[str, list[str]] = {}
    for name, (kind, _) in reasons:
        kinds.setdefault(kind, []).append(name)
    return tuple(f"{len(names)} agents ({shown(names)}): {kind}" for kind, names in kinds.items())


def shown(names: Sequence[str]) -> str:
    """The first names of a list."""
    return f"{', '.join(names[:NAMED_MAX])}{', ...' if len(names) > NAMED_MAX else ''}"
