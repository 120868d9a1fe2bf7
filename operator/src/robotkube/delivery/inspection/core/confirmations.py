"""Confirming strangers: what is strange once may be a pod that starts, a list that is read a moment before the other,
or a publication that was not followed yet. Only what two looks see, a while apart, is a stranger."""

from __future__ import annotations

from collections.abc import Iterable

from robotkube.delivery.inspection.core.strangers import Stranger

CONFIRM_SECONDS = 2.0


class Confirmations:
    """The strangers of one place, look by look; `known` are those that were confirmed before the process started."""

    def __init__(self, known: Iterable[Stranger] = ()) -> None:
        self._first: dict[tuple[str, ...], float] = {one.key: float("-inf") for one in known}

    def confirm(self, seen: Iterable[Stranger], now: float) -> tuple[tuple[Stranger, ...], bool]:
        """Of what a look at time `now` (seconds) saw the strangers that count, and whether others wait for the next
        look."""
        strangers = tuple(seen)
        self._first = {one.key: self._first.get(one.key, now) for one in strangers}
        confirmed = tuple(one for one in strangers if now - self._first[one.key] >= CONFIRM_SECONDS)
        return confirmed, len(confirmed) < len(strangers)
