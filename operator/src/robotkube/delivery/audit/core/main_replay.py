"""Main of the deployment repository, commit by commit: which release stood there from when to when, and what in each
commit is not as a plan's commit is.

Only what changes is read, so that long histories take time in proportion to what they changed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from robotkube.delivery.audit.core.findings import Finding, Place
from robotkube.delivery.deployment.core.commit_messages import REPAIR, CommitMessage, read_message
from robotkube.delivery.deployment.core.policies.merge import PATH as MERGE_PATH
from robotkube.delivery.deployment.core.policies.merge import MergePolicy, read_merge_policy
from robotkube.delivery.deployment.core.releases import (
    RELEASES,
    SOURCES,
    Release,
    Source,
    Tree,
    read_release,
    read_source,
)
from robotkube.delivery.deployment.core.unchecked_commits import BREAK_GLASS, UncheckedCommit
from robotkube.delivery.gate.core.proposal_checks import (
    ChangedRelease,
    ProposedCommit,
    changed_releases,
    message_problems,
)
from robotkube.errors import DocumentError
from robotkube.foundation.forge.core.histories import HistoryCommit
from robotkube.foundation.forge.core.trailers import claims

T = TypeVar("T")

CLOCK_SECONDS_MAX = 300  # by which clocks of those who make commits may differ
PATHS_NAMED_MAX = 5


@dataclass(frozen=True)
class MainChange:
    """One commit of main. `message` is what its plan says, None when it is no plan's or cannot be read; `changed` the
    releases that it changes; `signed_by`: the people whose signatures let it past the gate."""

    commit: HistoryCommit
    message: CommitMessage | None
    changed: tuple[ChangedRelease, ...]
    signed_by: tuple[str, ...] = ()

    @property
    def releases(self) -> tuple[str, ...]:
        """Keys of the changed releases."""
        return tuple(release.key for pair in self.changed if (release := pair.after or pair.before))


@dataclass(frozen=True)
class ReleaseRun:
    """A release as it stood on main: from the commit `began` until the commit `ended` (empty: until now), fetched from
    `url`."""

    release: Release
    began: str
    ended: str = ""
    url: str = ""


@dataclass(frozen=True)
class MainReplay:
    """All of main: its commits, the releases in the order in which they came, and findings."""

    changes: tuple[MainChange, ...] = ()
    runs: tuple[ReleaseRun, ...] = ()
    findings: tuple[Finding, ...] = ()


@dataclass
class _State:
    releases: dict[str, Release] = field(default_factory=dict)
    sources: dict[str, Source] = field(default_factory=dict)
    began: dict[str, str] = field(default_factory=dict)
    policy: MergePolicy | None = None


def replay(
    commits: Sequence[HistoryCommit], brought: Mapping[str, int], glass: Mapping[str, UncheckedCommit], now: int
) -> MainReplay:
    """Main as its commits (oldest first) made it. `brought`: merge commit that the gate did not sign for -> how many
    commits it brought; `glass`: commits without a record that say that they are break-glass; `now` is the present time
    in seconds since 1970."""
    state = _State()
    changes: list[MainChange] = []
    runs: list[ReleaseRun] = []
    findings: list[Finding] = []
    before: HistoryCommit | None = None
    for commit in commits:
        old = Tree({p: state.releases[p] for p in commit.changes if p in state.releases}, {})
        judged = glass.get(commit.id)
        signed_by = judged.names if judged is not None and judged.how == BREAK_GLASS else ()
        findings += [*_shape(commit, brought, judged), *time_findings(commit, before, now, "deployment")]
        findings += _apply(commit, state, runs)
        new = Tree({p: state.releases[p] for p in commit.changes if p in state.releases}, {})
        proposal = ProposedCommit(commit.parents, commit.message, commit.changes, commit.irregular, old, new)
        message, of_message = _message(commit, proposal, bool(signed_by))
        findings += of_message
        findings += _sources(commit, new.releases, state.sources)
        findings += _merge_policy(commit, state)
        changes.append(MainChange(commit, message, changed_releases(proposal), signed_by))
        before = commit
    runs += [
        ReleaseRun(release, state.began[path], "", _url(release, state.sources))
        for path, release in sorted(state.releases.items())
    ]
    return MainReplay(tuple(changes), _in_order(runs, commits), tuple(findings))


def _in_order(runs: Iterable[ReleaseRun], commits: Sequence[HistoryCommit]) -> tuple[ReleaseRun, ...]:
    places = {commit.id: index for index, commit in enumerate(commits)}
    return tuple(sorted(runs, key=lambda run: (places[run.began], run.release.key)))


def _shape(commit: HistoryCommit, brought: Mapping[str, int], judged: UncheckedCommit | None) -> Iterator[Finding]:
    if commit.id in brought:
        count = brought[commit.id]
        yield _finding(
            "merge-commit", commit, f"{len(commit.parents)} parents; it brings {count} commits of a side branch"
        )
    if judged is not None and judged.how == BREAK_GLASS:
        yield _finding("break-glass", commit, f"{_paths(commit.paths)}; signed by {', '.join(judged.names)}")
    elif judged is not None:
        yield _finding("break-glass-not-signed", commit, f"{_paths(commit.paths)}; {judged.problem}")
    if commit.problem:
        yield _finding("file-not-readable", commit, commit.problem)


def time_findings(commit: HistoryCommit, before: HistoryCommit | None, now: int, place: Place) -> Iterator[Finding]:
    """Times of a commit that cannot be: before its parent's, or in the future."""
    where = f"commit {commit.id}"
    early = before.committed - commit.committed if before else 0
    if early > CLOCK_SECONDS_MAX:
        what = f"it was made {early} s before the commit that it stands on"
        yield Finding("time-order", place, where, what, commit.id)
    late = max(commit.committed, commit.authored) - now
    if late > CLOCK_SECONDS_MAX:
        what = f"its time lies {late} s in the future"
        yield Finding("time-order", place, where, what, commit.id)


def _apply(commit: HistoryCommit, state: _State, runs: list[ReleaseRun]) -> Iterator[Finding]:
    """Change the state by a commit; runs that end with it are added to `runs`. A file that cannot be read leaves what
    stood there: Argo CD goes on with it."""
    for path in commit.irregular:
        if path.split("/", 1)[0] in (RELEASES, SOURCES):
            yield _finding("file-not-readable", commit, f"{path} is no ordinary text file")
    for path, text in sorted(commit.changes.items()):
        folder = path.split("/", 1)[0]
        if folder not in (RELEASES, SOURCES) or path.endswith("/.gitkeep"):
            continue
        try:
            if folder == SOURCES:
                _put(state.sources, path, read_source(text, path) if text is not None else None)
                continue
            release = read_release(text, path) if text is not None else None
        except DocumentError as error:
            yield _finding("file-not-readable", commit, str(error), f"{path.removeprefix('releases/')[:-5]}")
            continue
        if path in state.releases:
            former = state.releases[path]
            runs.append(ReleaseRun(former, state.began[path], commit.id, _url(former, state.sources)))
        _put(state.releases, path, release)
        state.began[path] = commit.id


def _put(values: dict[str, T], key: str, value: T | None) -> None:
    if value is None:
        values.pop(key, None)
    else:
        values[key] = value


def _url(release: Release, sources: Mapping[str, Source]) -> str:
    source = sources.get(f"{SOURCES}/{release.namespace}/{release.source_name}.yaml")
    return source.url if source else ""


def _message(
    commit: HistoryCommit, proposal: ProposedCommit, let_through: bool
) -> tuple[CommitMessage | None, list[Finding]]:
    """The plan in a commit's message, and what is wrong with it. The first commit, the seed, needs none, nor does one
    that leaves releases and sources alone, or that people's signatures let past the gate."""
    touched = [p for p in commit.paths if p.split("/", 1)[0] in (RELEASES, SOURCES) and not p.endswith("/.gitkeep")]
    try:
        message = read_message(commit.message)
    except DocumentError as error:
        if claims(commit.message, "Plan"):
            about = tuple(_keys(touched))
            return None, [_finding("plan-not-readable", commit, "; ".join(error.problems[:PATHS_NAMED_MAX]), *about)]
        if not touched or not commit.parents or let_through:
            return None, []
        what = f"{_paths(touched)}, by {commit.author}: {commit.subject!r}"
        return None, [_finding("changed-by-hand", commit, what, *_keys(touched))]
    problems = () if REPAIR in message.kinds else message_problems(message, proposal)
    others = [path for path in commit.paths if path not in touched]
    if others:
        problems = (*problems, f"a plan touches {_paths(others)}")
    return message, [_finding("trailers-differ", commit, problem, *_keys(touched)) for problem in problems]


def _sources(commit: HistoryCommit, changed: Mapping[str, Release], sources: Mapping[str, Source]) -> Iterator[Finding]:
    for release in changed.values():
        wanted = f"{SOURCES}/{release.namespace}/{release.source_name}.yaml"
        source = sources.get(wanted)
        if source is None:
            yield _finding("source-differs", commit, f"{release.path}: its source {wanted} is missing", release.key)
        elif (source.chart, source.digest) != (release.chart, release.digest):
            of_source = f"{source.chart}@{source.digest}"
            what = f"{release.path} names {release.chart}@{release.digest}, {wanted} leads to {of_source}"
            yield _finding("source-differs", commit, what, release.key)
    for path, text in sorted(commit.changes.items()):
        if path in sources and text is not None and sources[path].path != path:
            yield _finding("source-differs", commit, f"{path} is the file of {sources[path].path}")


def _merge_policy(commit: HistoryCommit, state: _State) -> Iterator[Finding]:
    """Findings when policies/merge.yaml lets more merge by itself than before."""
    text = commit.changes.get(MERGE_PATH)
    if text is None:
        return
    try:
        policy = read_merge_policy(text)
    except DocumentError:
        return  # nothing merges while it cannot be read
    former = state.policy
    state.policy = policy
    if former is None:
        return
    for account, prefixes in sorted(policy.automatic.items()):
        more = sorted(set(prefixes) - set(former.automatic.get(account, ())))
        if more:
            what = f"{MERGE_PATH}: what {account} proposes to {', '.join(more)} merges by itself now"
            yield _finding("policy-relaxed", commit, what)


def _keys(paths: Iterable[str]) -> list[str]:
    """Keys of the releases whose files these are."""
    return [
        path.removeprefix(f"{RELEASES}/").removesuffix(".yaml") for path in paths if path.startswith(f"{RELEASES}/")
    ]


def _paths(paths: Sequence[str]) -> str:
    more = f" and {len(paths) - PATHS_NAMED_MAX} others" if len(paths) > PATHS_NAMED_MAX else ""
    return (", ".join(paths[:PATHS_NAMED_MAX]) or "nothing") + more


def _finding(kind: str, commit: HistoryCommit, what: str, *about: str) -> Finding:
    return Finding(kind, "deployment", f"commit {commit.id}", what, commit.id, about)
