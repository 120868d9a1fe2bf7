"""A chart named by name, version and digest."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, order=True)
class ChartReference:
    """A chart as trailers name it: name@version@digest."""

    name: str
    version: str
    digest: str

    def __str__(self) -> str:
        return f"{self.name}@{self.version}@{self.digest}"
