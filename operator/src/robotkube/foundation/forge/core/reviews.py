"""A person's review of a pull request."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Review:
    """A review of a pull request when its head was `commit`: `approved`, or else against it; `official`
    when the forge knows the author as one with write rights."""

    author: str
    commit: str
    approved: bool
    official: bool
