"""Findings: what an audit found that should not be there, each of a kind that says what it means."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Place = Literal["deployment", "catalogue", "registry"]

MEANINGS = {
    "unchecked-commit": "the gate signed no record of this commit: main was moved past the gate, or its record was "
    "taken away",
    "no-records": "nothing shows that the gate checked anything: it never signed (an older version), or all its "
    "records were taken away",
    "record-not-valid": "this record proves nothing; its commit counts as not checked",
    "record-of-other-commit": "a record was copied to a commit that it is not about; that commit counts as not checked",
    "record-off-main": "the gate moved main to this commit, and main does not have it any more: main was rewritten",
    "record-contradicts-main": "the gate moved main from a commit that does not come before: main was rewritten",
    "records-removed": "records that were there when the gate signed this one are gone",
    "notes-replaced": "the notes' history was rewritten: notes that were there when the gate signed are gone or other",
    "note-edited": "the gate writes a note once; somebody changed or removed it afterwards",
    "outcome-of-other-commit": "an outcome was copied to another commit than it speaks of, or was changed",
    "outcome-not-readable": "what a manager saw of this plan was overwritten with something else",
    "outcome-off-main": "the outcome of a commit that main does not have: main was rewritten, or the note made up",
    "main-rewritten": "main does not have a commit that it had before: it was rewritten",
    "catalogue-rewritten": "the gate decided by a commit that the catalogue's main does not have: it was rewritten",
    "merge-commit": "the gate takes one commit on main's tip; a merge brings commits that nobody checked one by one",
    "file-not-readable": "main could not be read from here on; Argo CD stops with such a file",
    "changed-by-hand": "releases were changed by a commit that is no plan: no task, event or evidence is named for it",
    "plan-not-readable": "the commit names a plan, but its trailers do not hold: they were edited or made up",
    "trailers-differ": "the commit says something else than it does",
    "source-differs": "what Argo CD fetches is another chart than the release names",
    "break-glass": "registered people signed exactly this commit, so that it came past the gate; nobody else checked "
    "it",
    "break-glass-not-signed": "it says that people let it past the gate, and they did not sign it: main was moved past "
    "the gate and past the forge's hook",
    "time-order": "clocks were wrong, or times were made up: `when` cannot be trusted around this commit",
    "policy-relaxed": "from here on less was asked for before something could run",
    "no-evidence": "the release says itself that nothing was verified",
    "evidence-not-valid": "what ran was not shown to be what was verified",
    "entry-not-valid": "the catalogue offers a version whose evidence does not hold; it is selected nowhere",
    "application-not-verified": "what a task led to was not shown to come of an application that was checked",
    "application-not-valid": "the catalogue offers an application that is not what was checked; nothing is deployed "
    "for it while the policy asks for that",
    "catalogue-not-readable": "entries of the catalogue cannot be read; what they said is not known here",
    "not-in-catalogue": "the release names a chart that the catalogue did not have",
    "chart-missing": "what ran cannot be fetched any more: it was deleted, or its tag was written again",
    "tag-moved": "the tag leads to other bytes than were verified; releases name digests and do not follow it",
    "manifest-differs": "the registry's bytes are not those that were verified",
}


@dataclass(frozen=True)
class Finding:
    """One finding: its kind (of MEANINGS), the repository it is in, where there, and what was found, a sentence.

    `commit` is the commit that it came with, empty where there is none; `about` are names it concerns: releases,
    charts as `name@version`, digests."""

    kind: str
    place: Place
    where: str
    what: str
    commit: str = ""
    about: tuple[str, ...] = ()

    @property
    def meaning(self) -> str:
        """What it means."""
        return MEANINGS[self.kind]


def short(commit: str) -> str:
    """A commit's or digest's first 12 digits."""
    return commit.removeprefix("sha256:")[:12]


def unique(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """The findings in their order, each once."""
    return tuple(dict.fromkeys(findings))
