"""policies/edits.yaml: what happens to releases that a person changed, added or removed on main by hand.

    edits: revert      the manager brings main back to what the demands ask for, in a commit that names the person's
    edits: respect     they stay as the person left them until what the manager wants of them changes

Without the file edits are reverted. Always read from main.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final, Literal

from robotkube.domain.documents import Reader
from robotkube.domain.planning import Change, fingerprint
from robotkube.domain.texts import read_mapping

PATH = "policies/edits.yaml"
REVERT: Final = "revert"
RESPECT: Final = "respect"

EditsPolicy = Literal["revert", "respect"]


def read_edits_policy(text: str, path: str = PATH) -> EditsPolicy:
    """The policy in `text`; DocumentError names the key and what may stand there."""
    reader = Reader(path)
    document = reader.mapping(read_mapping(text, path), "", ["edits"])
    found = document.get("edits")
    if found not in (REVERT, RESPECT):
        reader.problems.append(f"edits: must be {REVERT} or {RESPECT}, found {found!r}")
    reader.finish()
    return RESPECT if found == RESPECT else REVERT


def respected(changes: Iterable[Change], edits: Mapping[str, str], first: dict[str, str]) -> tuple[Change, ...]:
    """Those of `changes` that may be made although people edited `edits` (path -> their commit) by hand.

    `first` remembers what was wanted of an edited release when its last edit was first seen (path -> that edit's commit
    and the change's fingerprint, or that none was wanted), and is brought up to date: an edit stands as long as that
    stays the same."""
    asked = {change.path: change for change in changes}
    wishes = {path: f"{commit} {_wish(asked.get(path))}" for path, commit in edits.items()}
    for path in [path for path in first if path not in edits]:
        del first[path]
    for path, wish in wishes.items():
        if not first.get(path, "").startswith(f"{edits[path]} "):
            first[path] = wish
    return tuple(change for path, change in asked.items() if path not in edits or first[path] != wishes[path])


def _wish(change: Change | None) -> str:
    return "" if change is None else fingerprint([change])
