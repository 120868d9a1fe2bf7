"""Findings of the preflight: what each check saw; of each problem what, where, why it matters and what mends it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

OK, FAILED, NOT_CHECKED = "ok", "failed", "not checked"
NAMES_MAX = 6
ACCOUNT = re.compile(r"://[^/@\s]*@")


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong: `fix` names the key of the values or the command that mends it."""

    what: str
    where: str
    why: str
    fix: str


@dataclass(frozen=True)
class CheckVerdict:
    """What a check made of the facts: `says` what was seen, the problems, and `unseen`, what could not be looked at."""

    says: str
    problems: Sequence[Problem] = ()
    unseen: str = ""


@dataclass(frozen=True)
class Unread:
    """A fact that was not read, and why: forbidden, not answered in time, absent."""

    why: str


@dataclass(frozen=True)
class ClusterFinding:
    """The outcome of one check: `result` is OK, FAILED or NOT_CHECKED. One that could not look is never OK."""

    check: str
    result: str
    says: str
    problems: tuple[Problem, ...] = ()

    @property
    def document(self) -> Mapping[str, Any]:
        """The finding as programs read it."""
        problems = [{"what": p.what, "where": p.where, "why": p.why, "fix": p.fix} for p in self.problems]
        return {"check": self.check, "result": self.result, "says": self.says, "problems": problems}


def named(names: Sequence[str]) -> str:
    """Names as a sentence has them: the first NAMES_MAX, and how many more."""
    more = len(names) - NAMES_MAX
    return ", ".join(names[:NAMES_MAX]) + (f" and {more} more" if more > 0 else "")


def gathered(problems: Sequence[Problem]) -> tuple[Problem, ...]:
    """Problems that differ in their places alone as one, with all of these."""
    places: dict[tuple[str, str, str], list[str]] = {}
    for problem in problems:
        places.setdefault((problem.what, problem.why, problem.fix), []).append(problem.where)
    return tuple(
        Problem(what, named(list(dict.fromkeys(where))), why, fix) for (what, why, fix), where in places.items()
    )


def without_accounts(text: str) -> str:
    """A text whose addresses name no account and no password."""
    return ACCOUNT.sub("://", text)
