"""What the gate decided last, with its checks, for who asks: GET /decisions."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.gate.core.check_results import CheckResult

DECISIONS_MAX = 200
PROBLEMS_MAX = 10  # of one check; all of them are in the pull request's comment


@dataclass(frozen=True)
class Decision:
    """What was decided about a commit of a pull request, how it may be merged, who approved it, and how many seconds
    that took. `verdict` is one of the statistics' words."""

    number: int
    author: str
    commit: str
    verdict: str
    way: str
    approvers: tuple[str, ...]
    checks: Sequence[CheckResult]
    seconds: float


class Decisions:
    """The last decisions, of each pull request the newest; for any thread. `wall` is the clock, in nanoseconds since
    1970."""

    def __init__(self, wall: Callable[[], int]) -> None:
        self._wall = wall
        self._documents: dict[int, Mapping[str, Any]] = {}
        self._lock = threading.Lock()

    def put(self, decision: Decision) -> None:
        """Keep a decision that stands now."""
        document = {
            "pull_request": decision.number,
            "author": decision.author,
            "commit": decision.commit,
            "verdict": decision.verdict,
            "way": decision.way,
            "approvers": list(decision.approvers),
            "decided": self._wall(),
            "seconds": decision.seconds,
            "checks": [_check(result) for result in decision.checks],
        }
        with self._lock:
            self._documents.pop(decision.number, None)
            self._documents[decision.number] = document
            if len(self._documents) > DECISIONS_MAX:
                del self._documents[next(iter(self._documents))]

    def as_json(self) -> Mapping[str, Any]:
        """The document of GET /decisions, the oldest first."""
        with self._lock:
            return {"decisions": list(self._documents.values())}


def _check(result: CheckResult) -> Mapping[str, Any]:
    problems = list(result.problems[:PROBLEMS_MAX])
    more = len(result.problems) - len(problems)
    problems += [f"and {more} more, in the pull request"] if more else []
    return {"check": result.name, "problems": problems, "seconds": result.seconds}
