"""Commits of main that the gate did not check, told apart by what they can show for themselves.

    break-glass   registered people have signed exactly it, so the forge's hook takes it without the gate
    not-signed    it says that it is break-glass, and what it carries are no such signatures
    no-record     neither: no record of the gate covers it

A record covers the commits from where main stood before to the one that it is about. Commits before the first record
were merged by a gate that signed none yet, or set the repository up: nothing is said about them, unless they say that
they are break-glass.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass

from robotkube.delivery.deployment.core.break_glass import (
    PEOPLE_MIN,
    SIGNATURES_MAX,
    SIGNERS_PATH,
    EmergencyChange,
    read_signers,
)
from robotkube.delivery.deployment.core.merge_records import MergeRecord
from robotkube.errors import DocumentError
from robotkube.foundation.forge.core.trailers import EMERGENCY, SIGNED_BY, named, trailer

BREAK_GLASS, NOT_SIGNED, NO_RECORD = WAYS = ("break-glass", "not-signed", "no-record")
_EMERGENCY = f"{named(EMERGENCY)}:"
_SIGNED_BY = trailer(SIGNED_BY, "")
ACCEPTED, REPLACED = "accepted", "replaced"
NOTHING_SIGNED = (
    "no commit of main has a valid record of the gate: it never signed one (an older gate), or all were taken away"
)
OTHERS_BEFORE = "the first record says that there were others before it: records of the gate were taken away"

Holds = Callable[[str, Iterable[bytes], bytes], bool]
"""Whether a signature is over a statement by one of these public keys (adapters.ssh_keys.holds)."""


@dataclass(frozen=True)
class UncheckedCommit:
    """A commit of main that the gate did not check. `how` is one of WAYS; `time`, `names` and `reason` are what its
    message says of itself (time and names only of break-glass); `problem`: why its signatures, or its record, do not
    hold; `files` those that main still has as it brought them; `made_good`: why it stands no more, ACCEPTED by a
    checked commit or REPLACED (main has none of its files any more, or a newer one changed them too); empty while it
    stands."""

    commit: str
    how: str
    reason: str
    time: str = ""
    names: tuple[str, ...] = ()
    problem: str = ""
    files: tuple[str, ...] = ()
    made_good: str = ""


@dataclass(frozen=True)
class GlassClaim:
    """A commit that says that it is break-glass, as far as signatures are about it. `protected`: those files that it
    changes although such a commit may not."""

    commit: str
    repository: str
    parents: tuple[str, ...]
    tree: str
    message: str
    protected: tuple[str, ...] = ()


def says_break_glass(message: str) -> bool:
    """Return whether a commit's message says that it is break-glass, well-formed or not."""
    return any(line.startswith(_EMERGENCY) for line in message.split("\n"))


def judge_claim(claim: GlassClaim, signers: str, holds: Holds) -> UncheckedCommit:
    """What the commit is: BREAK_GLASS when people registered in `signers` (the text of policies/signers before it) have
    signed it, as the forge's hook asks for; NOT_SIGNED with the problem otherwise."""
    lines = claim.message.split("\n")
    time = next((line.removeprefix(_EMERGENCY).strip() for line in lines if line.startswith(_EMERGENCY)), "")
    names = tuple(line.removeprefix(_SIGNED_BY).partition(" ")[0] for line in lines if line.startswith(_SIGNED_BY))
    problem = _problem(claim, signers, holds)
    how = NOT_SIGNED if problem else BREAK_GLASS
    return UncheckedCommit(claim.commit, how, lines[0], time, names, problem)


def _problem(claim: GlassClaim, signers: str, holds: Holds) -> str:
    """The first reason why the hook would not take it; empty when it would have, within minutes of its time."""
    lines = claim.message.split("\n")
    formed = len(lines) > 3 and bool(lines[0]) and not lines[1] and not lines[-1] and lines[2].startswith(_EMERGENCY)
    signatures = _signatures(lines[3:-1])
    if not formed or signatures is None:
        return "its message is not as `robotkube break-glass sign` writes it"
    if len(claim.parents) != 1:
        return f"it has {len(claim.parents)} parents, and signatures are for one commit on main's tip"
    if claim.protected:
        return f"it changes {', '.join(claim.protected)}, which no such commit may"
    try:
        registered = read_signers(signers)
    except DocumentError as error:
        return f"{SIGNERS_PATH} before it cannot be read: {'; '.join(error.problems)}"
    return _unsigned(claim, signatures, registered, holds)


def _signatures(trailers: Sequence[str]) -> Sequence[tuple[str, str]] | None:
    """Names with signatures; None when one of the lines is no signature, or when there are too many."""
    words = [line.removeprefix(_SIGNED_BY).split(" ") for line in trailers if line.startswith(_SIGNED_BY)]
    whole = len(words) == len(trailers) <= SIGNATURES_MAX and all(len(word) == 2 and all(word) for word in words)
    return [(name, signature) for name, signature in words] if whole else None


def _unsigned(
    claim: GlassClaim,
    signatures: Sequence[tuple[str, str]],
    registered: Mapping[str, Iterable[bytes]],
    holds: Holds,
) -> str:
    lines = claim.message.split("\n")
    time = lines[2].removeprefix(f"{_EMERGENCY} ")
    change = EmergencyChange(claim.repository.lower(), claim.parents[0], claim.tree, time, lines[0], {})
    for name, signature in signatures:
        if name not in registered:
            return f"{name} is none of the people in {SIGNERS_PATH} of the last checked commit before it"
        if not holds(signature, registered[name], change.statement):
            return f"what stands there as the signature of {name} is not over this commit, its parent, time and reason"
    people = len({name for name, _ in signatures})
    if people < PEOPLE_MIN:
        return f"signed by {people} of the people in {SIGNERS_PATH}; {PEOPLE_MIN} different ones are needed"
    return ""


def covered_by(record: MergeRecord, commits: Sequence[str], places: Mapping[str, int]) -> Sequence[str]:
    """The commits that a record covers, of main's `commits` (oldest first, `places` of each): from where main stood to
    the one that it is about; that one alone when main was not where it says."""
    last = places[record.commit]
    first = places.get(record.previous, last - 1) + 1 if record.previous else 0
    return commits[min(first, last) : last + 1]


def last_checked(commits: Sequence[str], place: int, unchecked: Container[str]) -> str:
    """The newest commit before a place that is not among the unchecked; empty when there is none."""
    return next((commit for commit in reversed(commits[:place]) if commit not in unchecked), "")


def records_problem(records: Iterable[MergeRecord], merged: bool) -> str:
    """What is wrong with all records together, a sentence; empty when nothing is. `merged`: main has more than its
    first commit."""
    known = list(records)
    if not known:
        return NOTHING_SIGNED if merged else ""
    return OTHERS_BEFORE if all(record.records for record in known) else ""
