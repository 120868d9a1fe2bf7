"""What the table of attacks is made of: an attack, and at each place what refuses it, in which words, shown by which
test, or why it cannot be seen there."""

from __future__ import annotations

import re
from dataclasses import dataclass

PLACES = ("selection", "gate", "admission", "nodes", "elsewhere")
ANY = "…"


@dataclass(frozen=True)
class Refused:
    """The words of a refusal, and the test that shows them: `<file below operator/tests>::<function>`. `by` says who
    refuses, where the place does not."""

    words: str
    test: str
    by: str = ""

    @property
    def pattern(self) -> re.Pattern[str]:
        """What a real refusal matches somewhere."""
        return re.compile(".*".join(map(re.escape, self.words.split(ANY))), re.DOTALL)


@dataclass(frozen=True)
class Unseen:
    """The reason why an attack cannot be seen at a place."""

    why: str


Cell = Refused | Unseen


@dataclass(frozen=True)
class Attack:
    """One attack: `key` for tests, a sentence for people, and its cells by place; `elsewhere` only where it is refused
    outside of the four places."""

    key: str
    sentence: str
    selection: Cell
    gate: Cell
    admission: Cell
    nodes: Cell
    elsewhere: Refused | None = None

    def cell(self, place: str) -> Cell | None:
        """The cell of one of PLACES."""
        if place not in PLACES:
            raise KeyError(f"{place!r} is none of {', '.join(PLACES)}")
        of_place: Cell | None = getattr(self, place)
        return of_place
