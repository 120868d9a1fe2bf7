"""The gate's checks of a pull request before it is merged: pure, all problems at once, each in words for people.

A proposal of a manager is one commit on main's tip that touches release and source files of its namespaces only. A
person's pull request may touch anything; what it brings is checked in the same way where it touches releases and
sources, and read where it touches policies. What main had wrong before does not count against a person, only what is
new. While main is broken a manager may propose nothing but the repair, which is computed here as there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from robotkube.delivery.deployment.core.borders import speaker
from robotkube.delivery.deployment.core.break_glass import ACCEPTED_PATH, SIGNERS_PATH, read_accepted, read_signers
from robotkube.delivery.deployment.core.commit_messages import REPAIR, CommitMessage, read_message
from robotkube.delivery.deployment.core.policies.agents import PATH as AGENTS_PATH
from robotkube.delivery.deployment.core.policies.agents import not_reserved, read_enrolled
from robotkube.delivery.deployment.core.policies.edits import PATH as EDITS_PATH
from robotkube.delivery.deployment.core.policies.edits import read_edits_policy
from robotkube.delivery.deployment.core.policies.initial import PATH as INITIAL_PATH
from robotkube.delivery.deployment.core.policies.initial import read_initial_policy
from robotkube.delivery.deployment.core.policies.links import FOLDER as LINKS_FOLDER
from robotkube.delivery.deployment.core.policies.links import read_consent, scope_of
from robotkube.delivery.deployment.core.policies.merge import PATH as MERGE_PATH
from robotkube.delivery.deployment.core.policies.merge import read_merge_policy
from robotkube.delivery.deployment.core.policies.revoked import PATH as REVOKED_PATH
from robotkube.delivery.deployment.core.policies.revoked import read_revoked
from robotkube.delivery.deployment.core.policies.updates import PATH as UPDATES_PATH
from robotkube.delivery.deployment.core.policies.updates import read_update_policy
from robotkube.delivery.deployment.core.releases import RELEASES, SOURCES, Release, TaskCause, Tree
from robotkube.delivery.gate.core import check_results as checks
from robotkube.delivery.gate.core.check_results import CheckLog, CheckResult, no_clock
from robotkube.delivery.gate.core.release_checks import Rules, release_problems, source_problems
from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.defaults import with_defaults
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.registry.charts.core.references import ChartReference
from robotkube.robots.ros.core.topic_patterns import AGENT

POLICIES = "policies"
BOOTSTRAP = "bootstrap"
SUSPECTS_NAMED_MAX = 5
CI_FOLDERS = frozenset({".gitea", ".github", ".gitlab", ".forgejo", ".circleci", ".woodpecker", "ci"})
CI_FILES = frozenset({".gitlab-ci.yml", ".gitlab-ci.yaml", ".drone.yml", ".woodpecker.yml", "Jenkinsfile"})


@dataclass(frozen=True)
class Proposer:
    """An account that may propose releases, and the namespaces that it may touch; `webhook`: where the gate notifies it
    of merges, empty for nowhere."""

    account: str
    namespaces: frozenset[str]
    webhook: str = ""


@dataclass(frozen=True)
class ProposedCommit:
    """A proposed commit: `changes` path -> new text (None = removed) against its (only) parent, `irregular` paths that
    are not ordinary text files; `before` and `after` are main's tip without and with the changes; `overlaps` are those
    paths of a person's change that main has changed, too."""

    parents: tuple[str, ...]
    message: str
    changes: Mapping[str, str | None]
    irregular: tuple[str, ...]
    before: Tree
    after: Tree
    overlaps: tuple[str, ...] = ()

    @property
    def paths(self) -> tuple[str, ...]:
        """Every path it touches."""
        return tuple(sorted({*self.changes, *self.irregular}))


@dataclass(frozen=True)
class ProposalVerdict:
    """The gate's decision about a proposed commit. `stale`: main has moved, so that the author has to build it again (a
    plan, on main's tip; a person's change, where both touched the same files). Else it is accepted when there is no
    problem. `repair`: it does nothing but bring a broken main back. `checks`: what was tried, and what came of it."""

    stale: bool = False
    problems: tuple[str, ...] = ()
    repair: bool = False
    checks: tuple[CheckResult, ...] = field(default=(), compare=False)

    @property
    def accepted(self) -> bool:
        """Return whether the commit may be merged."""
        return not self.stale and not self.problems


def folders_of(files: Mapping[str, str]) -> dict[str, str]:
    """Those of `files` that a proposal may touch."""
    return {path: text for path, text in files.items() if path.split("/", 1)[0] in (RELEASES, SOURCES)}


def apply_changes(files: Mapping[str, str], changes: Mapping[str, str | None]) -> dict[str, str]:
    """`files` after `changes`."""
    merged = {**files, **changes}
    return {path: text for path, text in merged.items() if text is not None}


def judge(proposal: ProposedCommit, tip: str, rules: Rules, clock: Callable[[], float] = no_clock) -> ProposalVerdict:
    """The verdict about a manager's proposal while main stands at `tip`. `clock` counts seconds, of each check."""
    log = CheckLog(clock)
    if problems := log.run(checks.ONE_COMMIT, _parent_problems(proposal)):
        return ProposalVerdict(problems=tuple(problems), checks=log.results)
    message, unreadable = _read_message(proposal.message)
    outdated = log.run(checks.AUTHOR, _author_problems(message, rules)) if message else ()
    if outdated:
        return ProposalVerdict(problems=tuple(outdated), checks=log.results)
    if proposal.parents[0] != tip:
        log.run(checks.ONE_COMMIT, [checks.MOVED])
        return ProposalVerdict(stale=True, checks=log.results)
    if rules.repair:
        return _judge_repair(proposal, message, rules, log)
    problems = [*log.run(checks.FILES, _paths(proposal, rules)), *_files(proposal, rules, log)]
    named = _message(message, changed_releases(proposal)) if message else unreadable
    problems += log.run(checks.MESSAGE, named)
    return ProposalVerdict(problems=tuple(problems), checks=log.results)


def _parent_problems(proposal: ProposedCommit) -> Iterable[str]:
    count = len(proposal.parents)
    if count != 1:
        yield f"the commit has {count} parents; it must have exactly one, main's tip"


def _read_message(text: str) -> tuple[CommitMessage | None, Sequence[str]]:
    try:
        return read_message(text), ()
    except DocumentError as error:
        return None, [f"{error.where}: {problem}" for problem in error.problems]


def _author_problems(message: CommitMessage, rules: Rules) -> Iterable[str]:
    """Problems of who proposes: another account, or a process that no longer leads and may not write any more."""
    if message.manager != rules.account:
        yield f"RobotKube-Manager: {message.manager!r} must be the account that proposes, {rules.account!r}"
    if message.term < rules.last_term:
        yield (
            f"RobotKube-Term: {message.term} is lower than {rules.last_term}, {rules.account}'s last on main: "
            "another process of this manager leads now"
        )


def _judge_repair(
    proposal: ProposedCommit, message: CommitMessage | None, rules: Rules, log: CheckLog
) -> ProposalVerdict:
    """The verdict about a proposal while main is broken: only what main last had passes, without anybody's approval."""
    broken = ", ".join(proposal.before.suspects[:SUSPECTS_NAMED_MAX])
    if message is None or REPAIR not in message.kinds:
        problem = f"main is broken ({broken}): a plan with RobotKube-Cause: {REPAIR} comes first"
        log.run(checks.REPAIR_ONLY, [problem])
        return ProposalVerdict(problems=(problem,), checks=log.results)
    touched = [*_emptiness(proposal), *(_irregular(path) for path in proposal.irregular)]
    problems = [*log.run(checks.FILES, touched), *log.run(checks.REPAIR_ONLY, _beyond_repair(proposal, rules))]
    problems += log.run(checks.NAMESPACES, _foreign_namespaces(proposal, rules))
    return ProposalVerdict(problems=tuple(problems), repair=not problems, checks=log.results)


def _beyond_repair(proposal: ProposedCommit, rules: Rules) -> Iterable[str]:
    for path, text in sorted(proposal.changes.items()):
        if path not in rules.repair or rules.repair[path] != text:
            yield f"{path}: a repair brings back what main last had, or removes what it did not have; this is neither"


def judge_person(proposal: ProposedCommit, rules: Rules, clock: Callable[[], float] = no_clock) -> ProposalVerdict:
    """The verdict about what a person proposes: files as `judge` asks of them, policies that can be read. The commit's
    message is the person's; `stale` does not keep the other problems from being named."""
    log = CheckLog(clock)
    problems = [*log.run(checks.FILES, _persons_paths(proposal)), *_files(proposal, rules, log)]
    problems += log.run(checks.POLICIES, _policies(proposal, rules))
    return ProposalVerdict(stale=bool(proposal.overlaps), problems=tuple(problems), checks=log.results)


def _persons_paths(proposal: ProposedCommit) -> Iterable[str]:
    yield from (_irregular(path) for path in proposal.irregular)
    yield from _emptiness(proposal)
    for path in sorted(proposal.changes):
        yield from _place(path)


@dataclass(frozen=True)
class ChangedRelease:
    """One release file that the proposal touches: None before = new, None after = removed (or not readable)."""

    path: str
    before: Release | None
    after: Release | None

    @property
    def evidence(self) -> str:
        """The evidence that the release file names, or named before it was removed."""
        release = self.after or self.before
        return release.evidence if release else ""


def changed_releases(proposal: ProposedCommit) -> tuple[ChangedRelease, ...]:
    """Every readable release file among the changes, by path."""
    pairs = (
        ChangedRelease(path, proposal.before.releases.get(path), proposal.after.releases.get(path))
        for path in sorted(proposal.changes)
    )
    return tuple(pair for pair in pairs if pair.before or pair.after)


def _files(proposal: ProposedCommit, rules: Rules, log: CheckLog) -> Iterable[str]:
    """Problems of the files that a change brings to releases/ and sources/, whoever proposes it."""
    yield from log.run(checks.TOGETHER, _new_problems(proposal))
    yield from log.run(checks.NAMESPACES, _foreign_namespaces(proposal, rules))
    yield from log.run(checks.USED, _orphans(proposal))
    for path in sorted(proposal.changes):
        if path in proposal.after.sources:
            yield from log.run(checks.ORIGIN, source_problems(path, proposal.after.sources[path], rules))
        if path in proposal.after.releases:
            yield from release_problems(path, proposal.after.releases[path], rules, log)


def _emptiness(proposal: ProposedCommit) -> Iterable[str]:
    if not proposal.paths:
        yield "the commit changes nothing"


def _irregular(path: str) -> str:
    return f"{path}: not an ordinary text file (a link, a program, binary or too long)"


def _paths(proposal: ProposedCommit, rules: Rules) -> Iterable[str]:
    yield from _emptiness(proposal)
    yield from (_irregular(path) for path in proposal.irregular)
    for path in proposal.paths:
        top = path.split("/", 1)[0]
        if top == POLICIES:
            yield f"{path}: policies are made by people; account {rules.account} may not change them"
        elif top == BOOTSTRAP:
            yield f"{path}: what installs the platform is changed by people; account {rules.account} may not touch it"
        elif top in CI_FOLDERS or path in CI_FILES:
            yield f"{path}: a forge runs what this file says; account {rules.account} may not touch it"
        elif top not in (RELEASES, SOURCES):
            yield f"{path}: a plan may only touch {RELEASES}/<namespace>/ and {SOURCES}/<namespace>/"
        elif path not in proposal.irregular:
            yield from _place(path)


def _place(path: str) -> Iterable[str]:
    """Problems of where a file stands: Argo CD's generator reads releases/ and sources/ at one depth only."""
    parts = path.split("/")
    if parts[0] not in (RELEASES, SOURCES) or parts[-1] == ".gitkeep":
        return
    if len(parts) != 3 or not parts[2].endswith(".yaml"):
        yield (
            f"{path}: a plan may only touch {RELEASES}/<namespace>/<release>.yaml and "
            f"{SOURCES}/<namespace>/<chart>-<digest12>.yaml"
        )


def _new_problems(proposal: ProposedCommit) -> Iterable[str]:
    old = set(proposal.before.problems)
    return (problem for problem in proposal.after.problems if problem not in old)


def _foreign_namespaces(proposal: ProposedCommit, rules: Rules) -> Iterable[str]:
    """Problems of files in namespaces of others. A file may be removed where no account is responsible any more, never
    where another one is."""
    for path, text in sorted(proposal.changes.items()):
        text = None if path in rules.repair and rules.repair[path] == text else text
        parts = path.split("/")
        if len(parts) != 3 or parts[0] not in (RELEASES, SOURCES):
            continue
        if text is not None and parts[1] in rules.reserved - rules.enrolled:
            yield f"{path}: {parts[1]} is reserved, and {AGENTS_PATH} on main does not enroll it: nothing may run there"
        elif parts[1] not in rules.namespaces and (text is not None or parts[1] in rules.others):
            allowed = ", ".join(sorted(rules.namespaces)) or "none"
            yield f"{path}: {parts[1]!r} is not a namespace that account {rules.account} may touch (it has {allowed})"


def _orphans(proposal: ProposedCommit) -> Iterable[str]:
    left = _unused_sources(proposal.after) - _unused_sources(proposal.before)
    yield from (f"{path}: no release uses this source; remove the file" for path in sorted(left))


def _unused_sources(tree: Tree) -> set[str]:
    used = {f"{SOURCES}/{r.namespace}/{r.source_name}.yaml" for r in tree.releases.values()}
    return set(tree.sources) - used


def _policies(proposal: ProposedCommit, rules: Rules) -> Iterable[str]:
    for path, text in sorted(proposal.changes.items()):
        if path.split("/", 1)[0] != POLICIES:
            continue
        try:
            yield from _policy(path, text, rules)
        except DocumentError as error:
            yield from (f"{error.where}: {problem}" for problem in error.problems)


def _policy(path: str, text: str | None, rules: Rules) -> Iterable[str]:
    if text is None:
        if path == MERGE_PATH:
            yield f"{path}: must stay; without it the gate merges nothing"
    elif path == SIGNERS_PATH:
        read_signers(text)
    elif path == ACCEPTED_PATH:
        read_accepted(text)
    elif not path.endswith(".yaml"):
        return
    elif path == MERGE_PATH:
        read_merge_policy(text, path)
    elif path == EDITS_PATH:
        read_edits_policy(text, path)
    elif path == INITIAL_PATH:
        yield from _initial(path, text, rules)
    elif path == UPDATES_PATH:
        read_update_policy(text, path)
    elif path == REVOKED_PATH:
        yield from _revoked(path, text, rules)
    elif path == AGENTS_PATH:
        yield from not_reserved(read_enrolled(text, path), rules.reserved, rules.namespaces | rules.others)
    elif path.startswith(f"{LINKS_FOLDER}/"):
        yield from _consent(path, text, rules)
    else:
        read_mapping(text, path)


def _initial(path: str, text: str, rules: Rules) -> Iterable[str]:
    for index, addition in enumerate(read_initial_policy(text, path).add):
        application = rules.catalogue.applications.get(addition.application)
        if application is None:
            known = ", ".join(sorted(rules.catalogue.applications)) or "none"
            yield f"{path}: add[{index}].application: the catalogue has no {addition.application!r}; it has {known}"
            continue
        if obstacle := rules.catalogue.forbids(application):
            yield f"{path}: add[{index}].application: {application.name}: {obstacle}"
        parameters = with_defaults(application.parameters, addition.parameters)
        problems = rules.validate(application.parameters, parameters, f"add[{index}].parameters")
        yield from (f"{path}: {problem}" for problem in problems)


def _revoked(path: str, text: str, rules: Rules) -> Iterable[str]:
    for index, agent in enumerate(read_revoked(text, path)):
        if agent not in rules.namespaces | rules.others:
            known = ", ".join(sorted(rules.namespaces | rules.others)) or "none"
            yield f"{path}: revoked[{index}].agent: no agent {agent} is declared; there are: {known}"


def _consent(path: str, text: str, rules: Rules) -> Iterable[str]:
    """Problems of what a scope consents to: of its own name, of other scopes' names, of topics of nobody there."""
    known = ", ".join(sorted(rules.accounts)) or "none"
    own = scope_of(path)
    if own not in rules.accounts:
        yield f"{path}: is no scope's file: {LINKS_FOLDER}/<manager>.yaml, and the managers are {known}"
        return
    consent = read_consent(text, path)
    for key, topics in (("sends", consent.sends), ("receives", consent.receives)):
        for other, names in topics.items():
            if other == own or other not in rules.accounts:
                yield f"{path}: {key}: {other} is no other manager; there are: {known}"
                continue
            sender = own if key == "sends" else other
            yield from (f"{path}: {key}: {problem}" for name in names for problem in _said(name, sender, rules))


def _said(topic: str, scope: str, rules: Rules) -> Iterable[str]:
    """Problems of a topic that agents of a scope are to say."""
    whose = speaker(topic)
    if whose not in (AGENT, *(agent for agent, its in rules.borders.scopes.items() if its == scope)):
        yield f"{topic} is said by no agent of scope {scope}: it must be below /vehicles/<agent>/ or /agents/<agent>/"


def message_problems(message: CommitMessage, proposal: ProposedCommit) -> tuple[str, ...]:
    """Differences between what a plan's message names and the releases that its commit changes."""
    return tuple(_message(message, changed_releases(proposal)))


def _message(message: CommitMessage, changed: Sequence[ChangedRelease]) -> Iterable[str]:
    for pair in changed:
        if pair.after and pair.after.plan != message.plan:
            yield f"{pair.path}: plan {pair.after.plan!r} differs from the commit's RobotKube-Plan {message.plan!r}"
    yield from _named_charts(message, changed)
    yield from _named_evidence(message, changed)
    yield from _named_tasks(message, changed)


def _named_charts(message: CommitMessage, changed: Sequence[ChangedRelease]) -> Iterable[str]:
    needed = {_reference(pair.after) for pair in changed if pair.after}
    allowed = needed | {_reference(pair.before) for pair in changed if pair.before}
    named = set(message.charts)
    yield from (f"RobotKube-Chart: {chart} is missing; a changed release uses it" for chart in sorted(needed - named))
    yield from (f"RobotKube-Chart: no changed release has {chart}" for chart in sorted(named - allowed))
    twice = sorted({chart for chart in message.charts if message.charts.count(chart) > 1})
    yield from (f"RobotKube-Chart: {chart} stands twice; keep one of them" for chart in twice)


def _named_evidence(message: CommitMessage, changed: Sequence[ChangedRelease]) -> Iterable[str]:
    """Problems of the evidence that the message names per chart; a release that stays counts before one that goes."""
    named = dict(zip(message.charts, message.evidence, strict=True))
    staying = {_reference(pair.after): pair for pair in changed if pair.after}
    going = {_reference(pair.before): pair for pair in changed if pair.before and not pair.after}
    for chart, pair in sorted((going | staying).items(), key=lambda item: item[0]):
        if chart in named and named[chart] != pair.evidence:
            yield f"RobotKube-Evidence of {chart} is {named[chart]}, {pair.path} has {pair.evidence}"


def _reference(release: Release) -> ChartReference:
    return ChartReference(release.chart, release.version, release.digest)


def _named_tasks(message: CommitMessage, changed: Sequence[ChangedRelease]) -> Iterable[str]:
    """Problems of the tasks that the message names: each whose demand on a changed release begins or ends, no other."""
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


def _causes(release: Release | None) -> tuple[TaskCause, ...]:
    """The causes of a release as a commit names them: without application and parameters."""
    return tuple(TaskCause(c.task, c.event, c.rule, c.trace, "") for c in release.causes) if release else ()
