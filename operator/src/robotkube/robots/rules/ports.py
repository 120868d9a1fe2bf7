"""Processes that evaluate rules for the detector: expressions and rules of installed packages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from robotkube.robots.rules.core import RuleAnswer, RuleQuestion


class Reply(NamedTuple):
    """The reply to one question: answers, or `error` when the rule failed at it."""

    answers: Sequence[RuleAnswer]
    error: str = ""


class RuleProcess(Protocol):
    """A process of one rule. Replies come in the order of the questions, one for each."""

    @property
    def ready(self) -> bool:
        """Return whether the rule is loaded and waits for questions."""
        ...

    @property
    def failure(self) -> str:
        """The reason why the process has ended or cannot start, in words; empty while it runs."""
        ...

    def ask(self, question: RuleQuestion) -> None:
        """Send a question; never blocks. The caller bounds how many wait."""
        ...

    def replies(self) -> Sequence[Reply]:
        """The replies that have come since the last call; never blocks."""
        ...

    def wait(self, seconds: float) -> None:
        """Wait until a reply is there or the process has ended, at most so long."""
        ...

    def stop(self) -> None:
        """End the process at once."""
        ...
