"""The errors of RobotKube.

    RobotKubeError             every error that this package raises on purpose
    ├── InputError             terminal: somebody has to change an input; names the place, the problems and the fix
    │   └── DocumentError      a YAML document (file, task, catalogue entry) breaks its rules
    ├── RefusalError           terminal for these inputs: a decision said no; carries a reason from a closed list
    └── UnavailableError       passing: a part of the world did not answer; the caller may try again within its bound
        └── AccountRefusedError    the account is not known there, or not yet: a process waits, a person need not

Library errors are translated at the adapter and chained; `retriable` says which ones a loop may try again.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches

SUGGESTIONS_MAX = 3
LIKENESS_MIN = 0.7


class RobotKubeError(Exception):
    """Base of all errors raised on purpose."""

    retriable = False


class InputError(RobotKubeError):
    """An input that its author has to change."""


class DocumentError(InputError):
    """A document with one or more problems, each a sentence that names the key and the fix.

    `where` is a path or an object's name; `problems` is never empty.
    """

    def __init__(self, where: str, problems: Sequence[str]) -> None:
        self.where = where
        self.problems = tuple(problems)
        super().__init__("; ".join(f"{where}: {problem}" for problem in self.problems))


class RefusalError(RobotKubeError):
    """A decision that said no: `reason` is from the closed list of the task's conditions."""

    def __init__(self, reason: str, message: str) -> None:
        self.reason = reason
        self.message = message
        super().__init__(f"{reason}: {message}")


class UnavailableError(RobotKubeError):
    """A part of the world (forge, API server, Argo CD) did not answer or answered with a passing fault."""

    retriable = True


class AccountRefusedError(UnavailableError):
    """The other side answers and refuses the account: its password is wrong, or it is not made yet."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """`did you mean vehicle-01? ` with the `known` names that are like `name`, for an error; empty when none is."""
    alike = get_close_matches(name, sorted(set(known)), SUGGESTIONS_MAX, LIKENESS_MIN)
    return f"did you mean {' or '.join(sorted(alike))}? " if alike else ""
