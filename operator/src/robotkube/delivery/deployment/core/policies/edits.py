"""policies/edits.yaml: what happens to releases that a person changed, added or removed on main by hand.

    edits: revert      the manager brings main back to what the demands ask for, in a commit that names the person's
    edits: respect     they stay as the person left them until what the manager wants of them changes

Without the file edits are reverted. Always read from main.
"""

from __future__ import annotations

from typing import Final, Literal

from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import read_mapping

PATH = "policies/edits.yaml"
REVERT: Final = "revert"
RESPECT: Final = "respect"

EditsPolicy = Literal["revert", "respect"]


def read_edits_policy(text: str, path: str = PATH) -> EditsPolicy:
    """The policy in `text`; DocumentError names the key and what may stand there."""
    reader = Reader(path)
    document = reader.mapping(read_mapping(text, path), "", ["edits"])
    policy = document.get("edits")
    if policy not in (REVERT, RESPECT):
        reader.problems.append(f"edits: must be {REVERT} or {RESPECT}, found {policy!r}")
    reader.finish()
    return RESPECT if policy == RESPECT else REVERT
