"""Where rules are evaluated that the detector does not evaluate itself: expressions and rules of installed packages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from robotkube.domain.rules import Answer, Question


class Reply(NamedTuple):
    """What came of one question: answers, or `error` when the rule failed at it."""

    answers: Sequence[Answer]
    error: str = ""


class RuleProcess(Protocol):
    """A process of one rule. Replies come in the order of the questions, one for each."""

    @property
    def ready(self) -> bool:
        """Whether the rule is loaded and waits for questions."""
        ...

    @property
    def failure(self) -> str:
        """Why the process has ended or cannot start, in words; empty while it is well."""
        ...

    def ask(self, question: Question) -> None:
        """Hand a question over; never blocks. Who asks bounds how many wait."""
        ...

    def replies(self) -> Sequence[Reply]:
        """The replies that have come since the last call; never blocks."""
        ...

    def wait(self, seconds: float) -> None:
        """Wait until a reply is there or the process has ended, at most so long."""
        ...

    def stop(self) -> None:
        """End it at once."""
        ...
