"""What the gate tells of commits that it did not check: what stands, what does no more, and nothing before it read."""

from __future__ import annotations

from typing import cast

from robotkube.delivery.deployment.core.unchecked_commits import BREAK_GLASS, NO_RECORD, REPLACED, UncheckedCommit
from robotkube.delivery.deployment.loops.unchecked_commits import UncheckedWatch
from robotkube.delivery.gate.loops.unchecked_report import NOTHING_READ, UncheckedReport
from robotkube.errors import UnavailableError

GLASS = UncheckedCommit("1" * 40, BREAK_GLASS, "the gate is away", "2026-11-21T10:00:10Z", ("ada", "grace"), "", ("x",))
MOVED = UncheckedCommit("2" * 40, NO_RECORD, "y", problem="its record is another one", made_good=REPLACED)


class Watch:
    """A watch that has read main, or cannot."""

    def __init__(self) -> None:
        self.away = False
        self.tip = "3" * 40
        self.problem = ""
        self.standing: tuple[UncheckedCommit, ...] = (GLASS,)
        self.made_good: tuple[UncheckedCommit, ...] = (MOVED,)

    def read(self) -> bool:
        if self.away:
            raise UnavailableError("the forge is away")
        return True


def test_commits_are_told_with_who_signed_why_and_what_became_of_them() -> None:
    watch = Watch()
    report = UncheckedReport(cast(UncheckedWatch, watch))
    assert report.as_json() == NOTHING_READ
    report.read()
    told = report.as_json()
    assert (told["tip"], told["problem"]) == (watch.tip, "")
    assert told["commits"] == [
        {
            "commit": GLASS.commit,
            "how": "break-glass",
            "reason": "the gate is away",
            "time": "2026-11-21T10:00:10Z",
            "signed_by": ["ada", "grace"],
            "problem": "",
            "files": ["x"],
            "made_good": "",
        },
        {
            "commit": MOVED.commit,
            "how": "no-record",
            "reason": "y",
            "time": "",
            "signed_by": [],
            "problem": "its record is another one",
            "files": [],
            "made_good": "replaced",
        },
    ]


def test_while_the_forge_is_away_it_tells_what_it_read_last() -> None:
    watch = Watch()
    report = UncheckedReport(cast(UncheckedWatch, watch))
    report.read()
    before = report.as_json()
    watch.away = True
    watch.standing = ()
    report.read()
    assert report.as_json() == before
