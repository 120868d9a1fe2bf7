"""The audit's document: what ran, who asked, what was verified, who approved, what was found, what cannot be told."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from robotkube.delivery.audit.core.findings import Finding
from robotkube.delivery.audit.core.made_good import MadeGood
from robotkube.delivery.audit.core.main_replay import MainChange, ReleaseRun
from robotkube.delivery.audit.core.merge_checks import Merges
from robotkube.delivery.audit.core.outcomes import Outcomes
from robotkube.delivery.audit.core.questions import Answered
from robotkube.delivery.deployment.core.releases import Release
from robotkube.foundation.documents.core.times import time_text
from robotkube.registry.evidence.core.statements import NONE

Row = dict[str, Any]
Evidence = tuple[str, str]
"""Digest of a chart, and of its evidence."""
PolicyRows = Callable[[Release, str, bool], Sequence[Row]]
"""The entries of policies because of which a release came or stayed with a commit, or (True) went with it."""


@dataclass(frozen=True)
class AuditScope:
    """What was looked at: tips of both repositories, keys that were trusted, the registry or why it was not asked, the
    commits that the caller knew before."""

    deployment: str
    deployment_commits: int
    catalogue: str
    catalogue_commits: int
    keys: tuple[str, ...]
    registry: str
    since: tuple[str, ...]
    at: int

    def row(self) -> Row:
        """The row by the names of the document."""
        return {
            "deployment": {"tip": self.deployment, "commits": self.deployment_commits},
            "catalogue": {"tip": self.catalogue, "commits": self.catalogue_commits},
            "keys": list(self.keys),
            "registry": self.registry or None,
            "since": list(self.since),
            "time": seconds_text(self.at),
        }


def document(
    answered: Answered,
    merges: Merges,
    outcomes: Outcomes,
    verified: Sequence[Row],
    applications: Sequence[Row],
    findings: Sequence[Finding],
    accepted: int,
    scope: AuditScope,
    policies: PolicyRows,
    ends: Mapping[str, MadeGood],
) -> Row:
    """The document of one audit. `accepted`: how many findings came with commits that the caller knew before; `ends`:
    what became of commits that the gate did not check."""
    commits = {change.commit.id for change in answered.changes}
    names = {run.release.key for run in answered.runs} | {run.release.digest for run in answered.runs}
    whole = not answered.word
    times = {change.commit.id: _time(change, merges) for change in answered.changes}
    by_evidence = {(row["digest"], row["evidence"]): row for row in verified}
    ran = [
        {**_run(run, times, outcomes, by_evidence), "policies": list(policies(run.release, run.began, False))}
        for run in answered.runs
    ]
    changes = [
        {**_change(change, merges, ends.get(change.commit.id)), "policies": list(_policies(change, policies))}
        for change in answered.changes
    ]
    return {
        "asked": answered.word,
        "understood_as": list(answered.as_),
        "as_of": scope.row(),
        "ran": ran,
        "changes": changes,
        "verified": list(verified),
        "applications": list(applications),
        "findings": [
            _finding(finding, whole or finding.commit in commits or bool(names & set(finding.about)))
            for finding in findings
        ],
        "findings_accepted": accepted,
        "cannot_be_told": [
            *_limits(answered, merges, outcomes, applications, scope),
            *_limits_of_policies([row for one in (*ran, *changes) for row in one["policies"]]),
        ],
    }


def _finding(finding: Finding, concerns: bool) -> Row:
    """The row of a finding. `concerns`: it has to do with what was asked for."""
    return {
        "finding": finding.kind,
        "place": finding.place,
        "where": finding.where,
        "what": finding.what,
        "means": finding.meaning,
        "commit": finding.commit or None,
        "concerns": concerns,
    }


def _run(run: ReleaseRun, times: Mapping[str, str], outcomes: Outcomes, verified: Mapping[Evidence, Row]) -> Row:
    release = run.release
    seen = outcomes.by_commit.get(run.began, {}).get(release.key)
    known = verified.get((release.digest, release.evidence))
    return {
        "release": release.key,
        "agent": release.namespace,
        "from": times.get(run.began, ""),
        "until": times.get(run.ended, "") if run.ended else None,
        "commit": run.began,
        "ended_by": run.ended or None,
        "plan": release.plan,
        "chart": release.chart,
        "version": release.version,
        "digest": release.digest,
        "evidence": release.evidence,
        "images": list(known["images"]) if known else [],
        "tasks": [cause.task for cause in release.causes],
        "observed": None
        if seen is None
        else {
            "nodes": list(seen.nodes),
            "images": list(seen.images),
            "at": time_text(seen.at) if seen.at is not None else None,
        },
    }


def _policies(change: MainChange, policies: PolicyRows) -> Iterator[Row]:
    """The entries because of which a plan changed releases that no task asks for, each once."""
    once: list[Row] = []
    for pair in change.changed if change.message else ():
        release = pair.after or pair.before
        rows = policies(release, change.commit.id, pair.after is None) if release else ()
        once += [row for row in rows if row not in once]
    yield from once


def _change(change: MainChange, merges: Merges, end: MadeGood | None) -> Row:
    commit = change.commit
    message = change.message
    record = merges.records.get(commit.id)
    return {
        "commit": commit.id,
        "time": _time(change, merges),
        "subject": commit.subject,
        "by": commit.author,
        "reason": message.reason if message else "",
        "tasks": [{"task": c.task, "event": c.event, "rule": c.rule, "trace": c.trace} for c in message.causes]
        if message
        else [],
        "causes": list(message.kinds) if message else [],
        "plan": message.plan if message else "",
        "manager": message.manager if message else "",
        "term": message.term if message else None,
        "releases": list(change.releases),
        "seed": not commit.parents,
        "break_glass": bool(change.signed_by),
        "signed_by": list(change.signed_by),
        "made_good": {"how": end.how, "commit": end.commit} if end else None,
        "checked": None
        if record is None
        else {
            "key": record.key,
            "at": record.time,
            "way": record.way,
            "pull_request": record.pull_request,
            "author": record.author,
            "approved_by": list(record.approvals),
            "catalogue": record.catalogue,
        },
    }


def _time(change: MainChange, merges: Merges) -> str:
    """The time at which main moved, by the gate's record; else when the commit was made, by its committer's clock."""
    record = merges.records.get(change.commit.id)
    return record.time if record else seconds_text(change.commit.committed)


def seconds_text(seconds: int) -> str:
    """Seconds since 1970 as RFC 3339; a time that no calendar has as the number."""
    try:
        return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%SZ}"
    except (OverflowError, ValueError, OSError):
        return f"{seconds} s"


def _limits(
    answered: Answered, merges: Merges, outcomes: Outcomes, applications: Sequence[Row], scope: AuditScope
) -> Iterator[str]:
    """What Git and registry cannot know here, a sentence each."""
    yield (
        "Cannot be told from Git: which containers ran, and when each of them started and ended. Git has what main "
        "asked for and when; what was observed a manager saw once, and nobody signed it."
    )
    yield "Cannot be told from Git: whether somebody changed workloads in the cluster itself, past Git and Argo CD."
    yield (
        "Cannot be told from Git: which person or program is behind a task. Git has the task, its event, rule and "
        "trace; its requester stands in the TaskDescription."
    )
    if "pod" in answered.as_:
        yield (
            f"Cannot be told from Git: whether a pod {answered.word} existed. By its name it belongs to the release "
            "shown; how many pods a release had, and their names, only the cluster knew."
        )
    if any(run.release.key not in outcomes.by_commit.get(run.began, {}) for run in answered.runs):
        yield "Cannot be told from Git: nodes of releases without `observed`; no outcome was written for their plan."
    if any(change.commit.id not in merges.records and change.commit.parents for change in answered.changes):
        yield (
            "Cannot be told from Git: who approved commits without a record of the gate; reviews stand in the forge "
            "alone. Their times are those of whoever made them."
        )
    if merges.unsigned:
        yield (
            f"Cannot be told from Git: whether the gate checked the {merges.unsigned} commits before its first record; "
            "an older gate signed nothing."
        )
    if not scope.since:
        yield (
            "Cannot be told from Git: whether main, catalogue and all notes together were put back to an earlier "
            "state. Keep the tips that this audit names, and give them to the next one (--since)."
        )
    if not scope.registry:
        yield "Not looked at: the OCI registry; whether charts are still there, and where their tags lead."
    unsigned = [row["application"] for row in applications if row["evidence"] == NONE]
    if unsigned:
        yield (
            f"Cannot be told from Git: who changed these applications of the catalogue: {', '.join(unsigned)}. No "
            "statement covers them; what they led to is in main, and was checked there."
        )


def _limits_of_policies(rows: Sequence[Row]) -> Iterator[str]:
    """What is not known of who asked by a policy."""
    if any(row["repository"] == "catalogue" for row in rows):
        yield (
            "Cannot be proved from Git: who proposed and approved changes of the catalogue (initialFor). Its commits "
            "say so, and nobody signed them."
        )
    if any(not row["author"] for row in rows):
        yield (
            "Cannot be told from Git: who submitted applications that an older gate published; it did not write that "
            "down. The pull request in the forge says it."
        )
