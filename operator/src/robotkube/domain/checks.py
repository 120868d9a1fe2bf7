"""What the gate asks of a proposal before it becomes main: pure, all problems at once, each a sentence for its author.

A proposal is one commit on main's tip that touches release and source files only. What main had wrong before does
not count against it, only what the proposal brings, so a proposal can repair a broken file.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from robotkube.domain.catalogue import ASSURANCES, Catalogue
from robotkube.domain.errors import DocumentError
from robotkube.domain.proposals import ChartReference, CommitMessage, read_message
from robotkube.domain.releases import RELEASES, SOURCES, Cause, Release, Tree

PROBLEMS_SHOWN_MAX = 50
STALE = "main moved"


@dataclass(frozen=True)
class Rules:
    """What holds in this installation: namespaces of the declared agents, where charts come from
    (`oci://host/organisation`), what the catalogue knows and allows."""

    namespaces: frozenset[str]
    charts_url: str
    catalogue: Catalogue


@dataclass(frozen=True)
class Proposal:
    """One proposed commit: `changes` path -> new text (None = removed) against its parent, `irregular` paths that are
    not ordinary text files; `before` and `after` are main's tip and the tree that the commit leaves."""

    parents: tuple[str, ...]
    message: str
    changes: Mapping[str, str | None]
    irregular: tuple[str, ...]
    before: Tree
    after: Tree


@dataclass(frozen=True)
class Verdict:
    """`stale`: the parent is not main's tip, the author has to build again. Else accepted when there is no problem."""

    stale: bool = False
    problems: tuple[str, ...] = ()

    @property
    def accepted(self) -> bool:
        """Whether the commit may become main."""
        return not self.stale and not self.problems


def folders_of(files: Mapping[str, str]) -> dict[str, str]:
    """Those of `files` that a proposal may touch."""
    return {path: text for path, text in files.items() if path.split("/", 1)[0] in (RELEASES, SOURCES)}


def apply_changes(files: Mapping[str, str], changes: Mapping[str, str | None]) -> dict[str, str]:
    """`files` after `changes`."""
    merged = {**files, **changes}
    return {path: text for path, text in merged.items() if text is not None}


def judge(proposal: Proposal, tip: str, rules: Rules) -> Verdict:
    """The decision about a proposal while main stands at `tip`."""
    if len(proposal.parents) != 1:
        count = len(proposal.parents)
        return Verdict(problems=(f"the commit has {count} parents; it must have exactly one, main's tip",))
    if proposal.parents[0] != tip:
        return Verdict(stale=True)
    problems = [*_paths(proposal), *_new_problems(proposal)]
    changed = changed_releases(proposal)
    problems += [*_foreign_namespaces(proposal, rules), *_orphans(proposal), *_charts(proposal, changed, rules)]
    try:
        problems += _message(read_message(proposal.message), proposal, changed, rules)
    except DocumentError as error:
        problems += [f"{error.where}: {problem}" for problem in error.problems]
    return Verdict(problems=tuple(problems))


@dataclass(frozen=True)
class ChangedRelease:
    """One release file that the proposal touches: None before = new, None after = removed (or not readable)."""

    path: str
    before: Release | None
    after: Release | None


def changed_releases(proposal: Proposal) -> tuple[ChangedRelease, ...]:
    """Every readable release file among the changes, by path."""
    pairs = (
        ChangedRelease(path, proposal.before.releases.get(path), proposal.after.releases.get(path))
        for path in sorted(proposal.changes)
    )
    return tuple(pair for pair in pairs if pair.before or pair.after)


def _paths(proposal: Proposal) -> Iterable[str]:
    if not proposal.changes and not proposal.irregular:
        yield "the commit changes nothing"
    for path in proposal.irregular:
        yield f"{path}: not an ordinary text file (a link, a program, binary or too long)"
    for path in proposal.changes:
        parts = path.split("/")
        if len(parts) != 3 or parts[0] not in (RELEASES, SOURCES) or not parts[2].endswith(".yaml"):
            yield (
                f"{path}: a plan may only touch {RELEASES}/<namespace>/<release>.yaml and "
                f"{SOURCES}/<namespace>/<chart>-<digest12>.yaml"
            )


def _new_problems(proposal: Proposal) -> Iterable[str]:
    old = set(proposal.before.problems)
    return (problem for problem in proposal.after.problems if problem not in old)


def _foreign_namespaces(proposal: Proposal, rules: Rules) -> Iterable[str]:
    for path, text in sorted(proposal.changes.items()):
        parts = path.split("/")
        if text is not None and len(parts) == 3 and parts[1] not in rules.namespaces:
            declared = ", ".join(sorted(rules.namespaces)) or "none"
            yield f"{path}: {parts[1]!r} is not the namespace of a declared agent (declared: {declared})"


def _orphans(proposal: Proposal) -> Iterable[str]:
    left = _unused_sources(proposal.after) - _unused_sources(proposal.before)
    yield from (f"{path}: no release uses this source; remove the file" for path in sorted(left))


def _unused_sources(tree: Tree) -> set[str]:
    used = {f"{SOURCES}/{r.namespace}/{r.source_name}.yaml" for r in tree.releases.values()}
    return set(tree.sources) - used


def _charts(proposal: Proposal, changed: Sequence[ChangedRelease], rules: Rules) -> Iterable[str]:
    for path in sorted(proposal.changes):
        source = proposal.after.sources.get(path)
        if source and source.url != f"{rules.charts_url}/{source.chart}":
            yield f"{path}: spec.url {source.url!r} must be {rules.charts_url}/{source.chart}"
    for pair in changed:
        if pair.after:
            yield from _chart(pair.path, pair.after, rules)


def _chart(path: str, release: Release, rules: Rules) -> Iterable[str]:
    wanted = ChartReference(release.chart, release.version, release.digest)
    known = {version.reference: version for version in rules.catalogue.charts.get(release.chart, ())}
    if wanted not in known:
        has = ", ".join(sorted(str(reference) for reference in known)) or "no version of it"
        yield f"{path}: chart {wanted} is not in the catalogue, which has {has}"
        return
    state, assurance = known[wanted].state, rules.catalogue.assurance
    if state not in ASSURANCES[assurance]:
        allowed = ", ".join(sorted(ASSURANCES[assurance]))
        yield f"{path}: chart {wanted} is {state}; the release policy (assurance: {assurance}) allows {allowed}"
    if assurance == "none" and release.evidence != "none":
        yield f"{path}: evidence {release.evidence!r} cannot be checked here; it must be `none`"


def _message(
    message: CommitMessage, proposal: Proposal, changed: Sequence[ChangedRelease], rules: Rules
) -> Iterable[str]:
    for pair in changed:
        if pair.after and pair.after.plan != message.plan:
            yield f"{pair.path}: plan {pair.after.plan!r} differs from the commit's RobotKube-Plan {message.plan!r}"
        if pair.after and pair.after.evidence != message.evidence:
            yield f"{pair.path}: evidence {pair.after.evidence!r} differs from RobotKube-Evidence {message.evidence!r}"
    yield from _named_charts(message, changed)
    yield from _named_tasks(message, changed)


def _named_charts(message: CommitMessage, changed: Sequence[ChangedRelease]) -> Iterable[str]:
    needed = {_reference(pair.after) for pair in changed if pair.after}
    allowed = needed | {_reference(pair.before) for pair in changed if pair.before}
    named = set(message.charts)
    yield from (f"RobotKube-Chart: {chart} is missing; a changed release uses it" for chart in sorted(needed - named))
    yield from (f"RobotKube-Chart: no changed release has {chart}" for chart in sorted(named - allowed))


def _reference(release: Release) -> ChartReference:
    return ChartReference(release.chart, release.version, release.digest)


def _named_tasks(message: CommitMessage, changed: Sequence[ChangedRelease]) -> Iterable[str]:
    """A task whose demand on a changed release begins or ends must be named; a named task must have to do with one."""
    before = {cause for pair in changed if pair.before for cause in _causes(pair.before)}
    after = {cause for pair in changed if pair.after for cause in _causes(pair.after)}
    moved = {c.task for pair in changed for c in set(_causes(pair.before)) ^ set(_causes(pair.after))}
    named = {cause.task: cause for cause in message.causes}
    yield from (f"RobotKube-Task: {task} is missing; its demand changes" for task in sorted(moved - set(named)))
    for task, cause in sorted(named.items()):
        now = {c for c in after if c.task == task}
        if not now and not any(c.task == task for c in before):
            yield f"RobotKube-Task: {task} has no part in any changed release"
        elif now and cause not in now:
            yield f"RobotKube-Task: event, rule or trace of {task} differ from the annotations of its releases"


def _causes(release: Release | None) -> tuple[Cause, ...]:
    """Causes as a commit names them: without the application."""
    return tuple(Cause(c.task, c.event, c.rule, c.trace, "") for c in release.causes) if release else ()


def refusal_text(problems: Sequence[str]) -> str:
    """The comment (Markdown) that tells the author of a proposal why it was refused."""
    shown = [f"- {' '.join(problem.split())}" for problem in problems[:PROBLEMS_SHOWN_MAX]]
    rest = len(problems) - len(shown)
    more = [f"- and {rest} more"] if rest > 0 else []
    return "\n".join(["Refused: the gate does not take this commit to main.", "", *shown, *more, ""])


def stale_text(parent: str, tip: str) -> str:
    """The comment that tells the author of a proposal that it has to be built again."""
    where = f"this commit was built on {parent[:12]}, main is at {tip[:12]}"
    return f"Closed, {STALE}: {where}. Build it again on main's tip.\n"
