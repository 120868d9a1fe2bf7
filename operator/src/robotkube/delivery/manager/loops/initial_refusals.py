"""Refusals of the initial configuration in the log: it has no task whose status could show them."""

from __future__ import annotations

import logging
from collections.abc import Mapping

from robotkube.delivery.manager.core.composition.inputs import Refused
from robotkube.delivery.manager.loops.verified_images import INITIAL

AGENTS_NAMED_MAX = 3

log = logging.getLogger(__name__)

_Problem = tuple[str, str, str]
"""Application, reason and words."""


class InitialRefusals:
    """The refusals that stand. What keeps an application from many agents with the same words is one line, when it
    comes and when the words change; agents that join it, and leave, are no news."""

    def __init__(self) -> None:
        self._reported: frozenset[_Problem] = frozenset()

    def report(self, outcomes: Mapping[str, object]) -> None:
        """Log what was not there the last time; `outcomes` by demand."""
        problems: dict[_Problem, list[str]] = {}
        for key, outcome in sorted(outcomes.items()):
            if isinstance(outcome, Refused) and key.startswith(INITIAL):
                application, _, agent = key.removeprefix(INITIAL).partition("/")
                problems.setdefault((application, outcome.reason, outcome.message), []).append(agent)
        for problem, agents in problems.items():
            if problem not in self._reported:
                application, cause, message = problem
                log.error(
                    "initial demand refused application=%s agents=%d first=%s cause=%s reason=%s",
                    *(application, len(agents), ",".join(agents[:AGENTS_NAMED_MAX]), cause, message),
                )
        self._reported = frozenset(problems)
