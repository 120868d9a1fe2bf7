"""Confirming strangers: what is strange once may be a pod that starts, a list that is read a moment before the other,
or a publication that was not followed yet. Only what looks see, a while apart, is a stranger."""

from __future__ import annotations

from collections.abc import Iterable

from robotkube.delivery.inspection.core.strangers import FOREIGN_CONTAINER, FOREIGN_POD, Stranger

CONFIRM_SECONDS = 2.0
RUNTIME_SECONDS = 4.0
"""For what the runtime has: kubelets keep that list for 2 s, so that of two looks 2 s apart the lists may be of nearly
the same time. A pod that came and ended between two looks is in both of them, and unknown to its kubelet."""
OF_THE_RUNTIME = (FOREIGN_POD, FOREIGN_CONTAINER)


class Confirmations:
    """The strangers of one place, look by look; `known` are those that were confirmed before the process started."""

    def __init__(self, known: Iterable[Stranger] = ()) -> None:
        self._first: dict[tuple[str, ...], float] = {one.key: float("-inf") for one in known}

    def confirm(self, seen: Iterable[Stranger], now: float) -> tuple[tuple[Stranger, ...], bool]:
        """Of what a look at time `now` (seconds) saw the strangers that count, and whether others wait for the next
        look."""
        strangers = tuple(seen)
        self._first = {stranger.key: self._first.get(stranger.key, now) for stranger in strangers}
        confirmed = tuple(stranger for stranger in strangers if now - self._first[stranger.key] >= _seconds(stranger))
        return confirmed, len(confirmed) < len(strangers)


def _seconds(one: Stranger) -> float:
    return RUNTIME_SECONDS if one.reason in OF_THE_RUNTIME else CONFIRM_SECONDS
