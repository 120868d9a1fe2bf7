"""`make reference`: the table of attacks in docs/explanation/trust.md, from ci/attacks/table.py."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ci.attacks.cells import Attack, Cell, Unseen
from ci.attacks.table import ATTACKS
from ci.folders import PROJECT

PAGE = PROJECT / "docs" / "explanation" / "trust.md"
BEGIN, END = "<!-- attacks: make reference writes this -->", "<!-- attacks end -->"
HEAD = ("attack", "selection", "gate", "admission", "nodes", "elsewhere")
TESTS = "../../operator/tests"


def section() -> str:
    """What stands between the markers: the table, and why cells without words have none."""
    reasons = list(dict.fromkeys(cell.why for one in ATTACKS for cell in _cells(one) if isinstance(cell, Unseen)))
    rows = [f"| {' | '.join(HEAD)} |", f"| {' | '.join(['---'] * len(HEAD))} |"]
    rows += [f"| {' | '.join([one.sentence, *(_text(cell, reasons) for cell in _cells(one))])} |" for one in ATTACKS]
    notes = [f"{number}. {why[0].upper()}{why[1:]}." for number, why in enumerate(reasons, 1)]
    return "\n".join([BEGIN, "", *rows, "", "Not seen there, because:", "", *notes, "", END])


def _cells(one: Attack) -> Iterator[Cell | None]:
    yield from (one.selection, one.gate, one.admission, one.nodes, one.elsewhere)


def _text(cell: Cell | None, reasons: list[str]) -> str:
    if cell is None:
        return "-"
    if isinstance(cell, Unseen):
        return f"- ({reasons.index(cell.why) + 1})"
    file, _, _ = cell.test.partition("::")
    words = cell.words.replace("|", "\\|")
    by = f"{cell.by}: " if cell.by else ""
    return f"{by}*{words}* ([test]({TESTS}/{file}))"


def rewritten(page: str) -> str:
    """The page with today's section."""
    before, rest = page.split(BEGIN, 1)
    return before + section() + rest.split(END, 1)[1]


def write() -> Path:
    """Write the page; its path."""
    PAGE.write_text(rewritten(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    return PAGE
