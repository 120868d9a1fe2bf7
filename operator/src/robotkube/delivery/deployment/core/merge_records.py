"""The gate's record of a merge: a signed statement that it checked a commit and moved main to it.

Each record is the note of its commit below `refs/notes/robotkube-gate`: an in-toto Statement about the commit, with the
predicate of a SLSA verification summary, in the envelope and under the key that evidence has. What evidence is about is
named by `sha256`, what a record is about by `gitCommit`, so that neither can be taken for the other.

Besides the commit a record signs what was seen when it was made: the commit that main stood at (`previous`), the tip of
the catalogue that was decided by, and the tips of both references with notes. So a main, a catalogue or notes that were
replaced afterwards contradict a signature.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.documents.core.patterns import COMMIT
from robotkube.foundation.documents.core.times import time_ns
from robotkube.registry.evidence.core.statements import (
    NONE,
    PASSED,
    STATEMENT_TYPE,
    SUMMARY_PREDICATE,
    VerifiedStatement,
)

REFERENCE = "refs/notes/robotkube-gate"
OUTCOMES_REFERENCE = "refs/notes/robotkube"  # plan_notes: what managers saw of their plans
LEVEL = "ROBOTKUBE_CHECKED"
POLICY = "policies/merge.yaml"
APPROVALS_MAX = 50

_TEXTS = ("previous", "author", "way", "pull_request", "approvals", "catalogue", "outcomes", "records")


@dataclass(frozen=True)
class MergeRecord:
    """A record as a value. `previous`: main before, empty when there was none; `author`: the account that proposed;
    `way`: what let it merge (automatic, approval, repair); `approvals`: accounts that approved exactly what was
    proposed; `time`: when main moved, by the gate's clock, RFC 3339.

    `catalogue`, `outcomes` and `records` are tips as the gate knew them then, empty where there was none; `key` is the
    id of the key that signed, empty while nobody has."""

    commit: str
    previous: str
    author: str
    way: str
    pull_request: str
    approvals: tuple[str, ...]
    time: str
    catalogue: str
    outcomes: str = ""
    records: str = ""
    key: str = ""

    def anchored(self, outcomes: str, records: str) -> MergeRecord:
        """The same with the tips of both references with notes."""
        return replace(self, outcomes=outcomes, records=records)


def record_statement(record: MergeRecord, repository: str, verifier: str) -> dict[str, Any]:
    """The statement that the gate signs; `repository` is the URL of the deployment repository, `verifier` who signs."""
    values = {
        "previous": record.previous or NONE,
        "author": record.author,
        "way": record.way,
        "pull_request": record.pull_request,
        "approvals": " ".join(record.approvals[:APPROVALS_MAX]),
        "catalogue": record.catalogue or NONE,
        "outcomes": record.outcomes or NONE,
        "records": record.records or NONE,
    }
    return {
        "_type": STATEMENT_TYPE,
        "subject": [{"name": "main", "digest": {"gitCommit": record.commit}, "annotations": values}],
        "predicateType": SUMMARY_PREDICATE,
        "predicate": {
            "verifier": {"id": verifier},
            "timeVerified": record.time,
            "resourceUri": f"git+{repository}@{record.commit}",
            "policy": {"uri": POLICY, "digest": {"gitCommit": record.previous or record.commit}},
            "verificationResult": PASSED,
            "verifiedLevels": [LEVEL],
        },
    }


def read_record(verified: VerifiedStatement) -> MergeRecord:
    """The record in a statement whose signature was verified; InputError when it is no such record."""
    subjects = verified.statement.get("subject")
    subject = _mapping(subjects[0]) if isinstance(subjects, list) and len(subjects) == 1 else {}
    commit = _mapping(subject.get("digest")).get("gitCommit")
    predicate = _mapping(verified.statement.get("predicate"))
    values = _mapping(subject.get("annotations"))
    levels = predicate.get("verifiedLevels")
    if not isinstance(commit, str) or levels != [LEVEL] or predicate.get("verificationResult") != PASSED:
        raise InputError("it is a signed statement about something else, no record of a merge")
    texts = {name: values.get(name) for name in _TEXTS}
    if not all(isinstance(text, str) for text in texts.values()):
        raise InputError(f"it lacks one of {', '.join(_TEXTS)}")
    tips = {name: str(texts[name]) for name in ("previous", "catalogue", "outcomes", "records")}
    if not all(COMMIT.fullmatch(text) or text == NONE for text in (commit, *tips.values())):
        raise InputError(f"one of commit, {', '.join(tips)} is no commit")
    time = str(predicate.get("timeVerified"))
    try:
        time_ns(time)
    except ValueError:
        raise InputError("its timeVerified is no time") from None
    return MergeRecord(
        commit=commit,
        author=str(texts["author"]),
        way=str(texts["way"]),
        pull_request=str(texts["pull_request"]),
        approvals=tuple(str(texts["approvals"]).split()),
        time=time,
        key=verified.key_id,
        **{name: "" if text == NONE else text for name, text in tips.items()},
    )


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}
