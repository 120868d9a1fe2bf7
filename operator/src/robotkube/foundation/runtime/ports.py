"""Ports of a process: when its own settings were read, and what it counts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol


class SettingsSource(Protocol):
    """The source of a process's own settings, as far as it says when they were read. Times are seconds of one clock."""

    @property
    def read_at(self) -> float | None:
        """The time at which the last reading began that the API server answered, None before the first. What it
        brought was reported before this says so."""
        ...

    @property
    def interrupted_at(self) -> float | None:
        """The time since which the API server is out of reach; None while it answers."""
        ...

    def read_again(self) -> None:
        """Read the settings now; returns at once."""
        ...


@dataclass(frozen=True)
class Series:
    """A metric at one moment, in base units: `values` are by the values of `labels`, in their order. The name of a
    counter ends in `_total`."""

    name: str
    kind: Literal["counter", "gauge"]
    text: str
    values: Mapping[tuple[str, ...], float]
    labels: tuple[str, ...] = ()


def by_one(values: Mapping[str, float]) -> Mapping[tuple[str, ...], float]:
    """Values of a series with a single label."""
    return {(name,): value for name, value in values.items()}
