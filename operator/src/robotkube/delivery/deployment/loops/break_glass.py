"""Break-glass commits that stand on main: found again from Git alone, whenever main has moved."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

from robotkube.delivery.deployment.core.break_glass import (
    ACCEPTED_PATH,
    GlassCommit,
    read_accepted,
    read_glass_message,
)
from robotkube.errors import DocumentError
from robotkube.foundation.forge.ports.repositories import MainBranch

COMMITS_MAX = 10_000  # how far back main is searched for them
POLICIES = "policies"
EVERYTHING = "everything"

log = logging.getLogger(__name__)


class BreakGlassWatch:
    """The break-glass commits of one repository that stand: main still has a file as one of them brought it, and no
    checked commit has accepted it. Read again when main moved."""

    def __init__(self, main: MainBranch) -> None:
        self._main = main
        self._tip = ""
        self._known: list[GlassCommit] = []
        self.standing: tuple[GlassCommit, ...] = ()

    def read(self) -> bool:
        """Read main's new commits; whether what stands has changed."""
        tip = self._main.tip
        if tip == self._tip:
            return False
        found = (read_glass_message(commit, text) for commit, text in self._main.headers(self._tip, COMMITS_MAX))
        self._known = [*(glass for glass in found if glass is not None), *self._known]
        self._tip = tip
        before = self.standing
        self.standing = self._read_standing(tip) if self._known else ()
        return self.standing != before

    def _read_standing(self, tip: str) -> tuple[GlassCommit, ...]:
        """Those of the known commits that stand, newest first, with the files; a file counts for the newest alone."""
        accepted = self._accepted(tip)
        counted: set[str] = set()
        found: list[GlassCommit] = []
        for glass in self._known:
            files = tuple(path for path in self._files(glass) if path not in counted)
            counted.update(files)
            if files and glass.commit not in accepted:
                found.append(replace(glass, files=files))
        return tuple(found)

    def _files(self, glass: GlassCommit) -> Sequence[str]:
        """The files that main still has as the commit brought them; of one that is too large to compare, EVERYTHING,
        which nothing but its acceptance takes away."""
        try:
            return self._main.still_as_in(glass.commit)
        except DocumentError as error:
            log.error("break-glass cannot be compared commit=%s problem=%r", glass.commit, str(error))
            return (f"{EVERYTHING} of {glass.commit[:12]}",)

    def _accepted(self, tip: str) -> frozenset[str]:
        try:
            return read_accepted(self._main.files(tip, (POLICIES,)).get(ACCEPTED_PATH, ""))
        except DocumentError as error:
            log.error("accepted commits unusable commit=%s problem=%r", tip[:12], str(error))
            return frozenset()  # what cannot be read accepts nothing
