"""Words of others on a terminal: reasons of tasks, messages of pods and of commits are whatever somebody wrote, an
agent's process among them."""

from __future__ import annotations

KEPT = "\n\t"


def printable(text: str) -> str:
    """`text` without what would steer a terminal, a question mark in the place of each such character."""
    return "".join(one if one.isprintable() or one in KEPT else "?" for one in text)
