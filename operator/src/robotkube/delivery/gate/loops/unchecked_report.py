"""What came to main without the gate's check, as the gate reports it: in its log, counted for the metrics, and one by
one for who asks, GET /unchecked."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.delivery.deployment.core.unchecked_commits import BREAK_GLASS, NO_RECORD, NOT_SIGNED, UncheckedCommit
from robotkube.delivery.deployment.loops.unchecked_commits import UncheckedWatch
from robotkube.errors import RobotKubeError

NOTHING_READ: Mapping[str, Any] = {"tip": "", "problem": "", "commits": []}
"""What GET /unchecked says before main was read."""

log = logging.getLogger(__name__)


@dataclass
class UncheckedCounts:
    """Commits and files of break-glass that stand, and other commits that stand by why they count as unchecked."""

    break_glass_commits: int = 0
    break_glass_files: int = 0
    others: dict[str, int] = field(default_factory=lambda: dict.fromkeys((NOT_SIGNED, NO_RECORD), 0))


class UncheckedReport:
    """Reads a watch whenever the gate has ended a round, and says what has changed."""

    def __init__(self, watch: UncheckedWatch) -> None:
        self.watch = watch
        self.counts = UncheckedCounts()
        self._document = NOTHING_READ

    def as_json(self) -> Mapping[str, Any]:
        """The document of GET /unchecked, for any thread: those that stand, and then those that do no more, the newest
        first. `tip` is empty while main was not read."""
        return self._document

    def read(self) -> None:
        """Read main; what cannot be read now is read in the next round."""
        try:
            changed = self.watch.read()
        except RobotKubeError as error:
            log.warning("unchecked commits of main not read reason=%s", error)
            return
        watch = self.watch
        commits = [_commit(one) for one in (*watch.standing, *watch.made_good)]
        self._document = {"tip": watch.tip, "problem": watch.problem, "commits": commits}
        if changed:
            self._report(watch.standing)

    def _report(self, standing: Sequence[UncheckedCommit]) -> None:
        glass = [one for one in standing if one.how == BREAK_GLASS]
        files = {path for one in glass for path in one.files}
        others = {how: sum(one.how == how for one in standing) for how in self.counts.others}
        self.counts = UncheckedCounts(len(glass), len(files), others)
        for one in standing:
            if one.how == BREAK_GLASS:
                log.error(
                    "break-glass stands commit=%s committed=%s signed_by=%s files=%s reason=%r",
                    *(one.commit, one.time, ",".join(one.names), ",".join(one.files), one.reason),
                )
            else:
                log.error(
                    "unchecked commit stands commit=%s how=%s files=%s problem=%r subject=%r",
                    *(one.commit, one.how, ",".join(one.files), one.problem, one.reason),
                )
        if not standing:
            log.info("main has nothing any more that came without the gate")


def _commit(one: UncheckedCommit) -> Mapping[str, Any]:
    return {
        "commit": one.commit,
        "how": one.how,
        "reason": one.reason,
        "time": one.time,
        "signed_by": list(one.names),
        "problem": one.problem,
        "files": list(one.files),
        "made_good": one.made_good,
    }
