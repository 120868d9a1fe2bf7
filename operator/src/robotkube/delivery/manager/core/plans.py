"""Plan: the ordered difference between desired and present releases, as files, commit message and pull request text."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256

from robotkube.delivery.deployment.core.commit_messages import INITIAL, CommitMessage
from robotkube.delivery.deployment.core.releases import (
    ChartOf,
    Release,
    TaskCause,
    Tree,
    chart_of,
    source_of,
    write_release,
    write_source,
)
from robotkube.delivery.manager.core.composition.composer import Composition, Met, Refused
from robotkube.delivery.manager.core.composition.index import placed_on
from robotkube.delivery.manager.core.placement.placement import Fleet
from robotkube.delivery.tasks.core.task_description import TaskDescription
from robotkube.registry.catalogue.core.catalogue import Catalogue
from robotkube.registry.charts.core.references import ChartReference

ADD = "add"
CHANGE = "change"
REMOVE = "remove"


@dataclass(frozen=True)
class Change:
    """One release that differs; `before` is None for a new one, `after` None for one that goes."""

    path: str
    before: Release | None
    after: Release | None

    @property
    def kind(self) -> str:
        """add, change or remove."""
        return ADD if self.before is None else REMOVE if self.after is None else CHANGE

    @property
    def release(self) -> Release:
        """The newer of both sides."""
        release = self.after or self.before
        assert release is not None
        return release


@dataclass(frozen=True)
class Plan:
    """The changes of one commit. `files` are path -> text, None removes; `message` names the tasks that come or go."""

    id: str
    base: str
    changes: tuple[Change, ...]
    files: Mapping[str, str | None]
    message: CommitMessage

    @property
    def title(self) -> str:
        """Title of the pull request."""
        return self.message.subject

    @property
    def fingerprint(self) -> str:
        """The fingerprint of the changes: equal for plans that would do the same on whatever base."""
        return fingerprint(self.changes)


def differences(desired: Mapping[str, Release], present: Mapping[str, Release]) -> tuple[Change, ...]:
    """Releases that differ in anything but the plan that wrote them; those that go come last, else by path."""
    changes = [Change(path, before, None) for path, before in present.items() if path not in desired]
    for path, after in desired.items():
        before = present.get(path)
        if before is not after and (before is None or not before.same_but_plan(after)):
            changes.append(Change(path, before, after))
    return tuple(sorted(changes, key=lambda c: (c.kind == REMOVE, c.path)))


def fingerprint(changes: Iterable[Change]) -> str:
    """The digest that identifies a difference; a plan's id has 6 hexadecimal digits of such a one."""
    digest = sha256()
    for change in changes:
        content = _content(change.after) if change.after else ""
        digest.update(f"{change.kind} {change.path}\n{content}\n".encode())
    return digest.hexdigest()


def _content(release: Release) -> str:
    causes = [vars(cause) for cause in release.causes]
    return json.dumps({**vars(release), "plan": "", "causes": causes}, sort_keys=True)


def make_plan(
    changes: tuple[Change, ...],
    tree: Tree,
    desired: Composition,
    tasks: Mapping[str, TaskDescription],
    catalogue: Catalogue,
    registry: str,
    base: str,
    now: str,
    cause: str = "",
    reason: str = "",
) -> Plan:
    """The plan for `changes` on commit `base`; `registry` is oci://host/organisation, `now` `YYYYMMDD-HHMMSS` (UTC).
    `cause` (of proposals.KINDS) and `reason` say why it changes releases without any task's having asked."""
    identifier = f"{now}-{sha256((base + fingerprint(changes)).encode()).hexdigest()[:6]}"
    stamped = tuple(replace(c, after=replace(c.after, plan=identifier)) if c.after else c for c in changes)
    message = _message(stamped, desired, tasks, catalogue, identifier)
    if cause:
        kinds = tuple(sorted({*message.kinds, cause} - {INITIAL}))
        message = replace(message, kinds=kinds, area=cause, reason=reason, verb="deploy")
    files = _files(stamped, tree, registry)
    return Plan(identifier, base, stamped, files, message)


def _files(changes: Iterable[Change], tree: Tree, registry: str) -> dict[str, str | None]:
    """Release files of the changes, and exactly the sources that the resulting releases need."""
    files: dict[str, str | None] = {}
    users = Counter[ChartOf]()
    for change in changes:
        files[change.path] = write_release(change.after) if change.after else None
        before = tree.releases.get(change.path)
        users.subtract([chart_of(before)] if before else [])
        users.update([chart_of(change.after)] if change.after else [])
    return files | _source_files(users, tree, registry)


def _source_files(users: Mapping[ChartOf, int], tree: Tree, registry: str) -> dict[str, str | None]:
    """The changes of source files when there are so many `users` more or less of each chart."""
    left = {chart: tree.users.get(chart, 0) + more for chart, more in users.items()}
    wrong, unused = tree.wrong_sources(registry)
    needed = {c: s for c, s in wrong.items() if left.get(c, 1)}
    for chart in (chart for chart, count in left.items() if count and chart not in tree.users):
        source = source_of(chart, registry)
        if tree.sources.get(source.path) != source:
            needed[chart] = source
    paths = {source_of(chart, registry).path for chart, count in left.items() if count}
    gone = {source_of(chart, registry).path for chart, count in left.items() if not count} | unused
    files = {source.path: write_source(source) for source in sorted(needed.values(), key=lambda s: s.path)}
    return files | {path: None for path in sorted(gone - paths) if path in tree.sources}


def lost_node_text(changes: Iterable[Change], fleet: Fleet, now_ns: int) -> str:
    """The moves away from lost nodes, for the commit's subject: `node vehicle-03 lost for 41 s: recorder moved to
    cloud-1`; empty when nothing moves for that."""
    changes = tuple(changes)
    targets = {c.release.name: c.release.namespace for c in changes if c.kind == ADD}
    moved: dict[str, list[str]] = {}
    for change in changes:
        name = change.release.name
        target = targets.get(change.release.name, "")
        node = placed_on(change.before, "node") if change.before else ""
        if change.after and node != placed_on(change.after, "node"):
            other = placed_on(change.after, "node")
            target = (f"node {other}" if other else "its other node") if node else ""
        elif change.kind != REMOVE:
            continue
        for agent in fleet.by_namespace.get(change.release.namespace, ()) if target else ():
            if why := fleet.loss(agent, now_ns, node):
                moved.setdefault(why, []).append(f"{name} moved to {target}")
    return "; ".join(f"{why}: {', '.join(moves)}" for why, moves in sorted(moved.items()))


def answered_and_withdrawn(changes: Iterable[Change]) -> tuple[frozenset[TaskCause], frozenset[TaskCause]]:
    """The tasks that the changes newly answer, and those that they no longer answer anywhere among changed releases."""
    after = {c for change in changes if change.after for c in change.after.causes}
    before = {c for change in changes if change.before for c in change.before.causes}
    return frozenset(after - before), frozenset(before - after)


def _message(
    changes: tuple[Change, ...],
    desired: Composition,
    tasks: Mapping[str, TaskDescription],
    catalogue: Catalogue,
    plan: str,
) -> CommitMessage:
    come, go = answered_and_withdrawn(changes)
    causes = set(come | go)
    initial = False
    for change in changes:
        before = set(change.before.causes) if change.before else set()
        after = set(change.after.causes) if change.after else set()
        causes |= after if before == after else before ^ after  # what moves comes here and goes there
        initial |= not (before | after) or (before == after and change.path in desired.initial)
    area, reason = _reason(changes, come, go, tasks, catalogue)
    evidence = _evidence(changes)
    verb = "withdraw" if go and not come and not initial else "deploy"
    return CommitMessage(
        verb=verb,
        area=area,
        reason=reason,
        plan=plan,
        causes=tuple(sorted(causes)),
        kinds=(INITIAL,) if initial or not causes else (),
        charts=tuple(sorted(evidence)),
        evidence=tuple(evidence[chart] for chart in sorted(evidence)),
    )


def _evidence(changes: Iterable[Change]) -> dict[ChartReference, str]:
    """The evidence of every chart of the changed releases; of releases that stay rather than of those that go."""
    evidence: dict[ChartReference, str] = {}
    for change in sorted(changes, key=lambda c: c.kind != REMOVE):
        release = change.release
        evidence[ChartReference(release.chart, release.version, release.digest)] = release.evidence
    return evidence


def _reason(
    changes: tuple[Change, ...],
    come: frozenset[TaskCause],
    go: frozenset[TaskCause],
    tasks: Mapping[str, TaskDescription],
    catalogue: Catalogue,
) -> tuple[str, str]:
    """The area and the reason of the subject: of the first task that comes, else goes, else of the configuration."""
    chosen = sorted(come) or sorted(go)
    if not chosen:
        return INITIAL, f"{len(changes)} releases" if len(changes) != 1 else changes[0].release.key
    first = chosen[0]
    application = catalogue.applications.get(first.application)
    reason = tasks[first.task].reason if first.task in tasks else first.task
    more = f" and {len(chosen) - 1} more" if len(chosen) > 1 else ""
    return (application.area if application else first.application), f"{reason or first.task}{more}"


def describe(
    plan: Plan, desired: Composition, tasks: Mapping[str, TaskDescription], catalogue: Catalogue, suites: Sequence[str]
) -> str:
    """The pull request's body (Markdown): what was asked, every choice with its reason, what changes, the evidence.
    `suites` are those of the verification policy."""
    lines = [f"Plan `{plan.id}` on `{plan.base[:12]}`.", "", "## Asked", ""]
    come, go = answered_and_withdrawn(plan.changes)
    for cause in sorted(come):
        task = tasks.get(cause.task)
        reason = f": {_quoted(task.reason)}" if task else ""
        lines.append(f"- `{cause.task}` asks for {cause.application} (rule {cause.rule}, event {cause.event}){reason}")
    lines += [f"- `{c.task}` is withdrawn (rule {c.rule}, event {c.event})" for c in sorted(go)]
    if plan.message.initial:
        lines.append("- the initial configuration (catalogue and policies/)")
    lines += ["", "## Decided", ""]
    lines += [f"- `{key}`: {choice}" for key, choice in decided(plan, desired)]
    refused = {k: o for k, o in desired.outcomes.items() if isinstance(o, Refused)}
    lines += [f"- `{key}` is refused, {o.reason}: {_quoted(o.message)}" for key, o in sorted(refused.items())]
    lines += ["", "## Changes", ""]
    for change in plan.changes:
        lines.append(
            f"- {change.kind} `{change.release.key}` ({change.release.chart} {change.release.version}){_delta(change)}"
        )
    return "\n".join([*lines, "", *_evidence_lines(plan.message, catalogue, suites)]) + "\n"


def decided(plan: Plan, desired: Composition) -> Iterator[tuple[str, str]]:
    """Every choice that was made for the tasks that come with a plan, as a sentence with its reason, by task."""
    come, _ = answered_and_withdrawn(plan.changes)
    for key in [cause.task for cause in sorted(come)]:
        outcome = desired.outcomes.get(key)
        if isinstance(outcome, Met):
            yield from ((key, choice) for choice in outcome.choices)


def _evidence_lines(message: CommitMessage, catalogue: Catalogue, suites: Sequence[str]) -> list[str]:
    """The section about evidence: per chart what proves it, and its guarantees, which nothing proves yet."""
    lines = ["## Evidence", "", f"Assurance of the release policy: **{catalogue.assurance}**.", ""]
    for chart, evidence in zip(message.charts, message.evidence, strict=True):
        version = catalogue.version(chart.name, chart.version)
        if evidence == "none" or version is None:
            lines.append(f"- {chart.name} {chart.version}: none")
        else:
            lines.append(
                f"- {chart.name} {chart.version}: passed {', '.join(suites)} under policy `{version.policy[:19]}`; "
                f"summary `{evidence}`"
            )
        declared = [str(guarantee) for guarantee in version.guarantees] if version else []
        lines += [f"  - guarantees: {', '.join(declared)}"] if declared else []
    return lines


def _quoted(text: str) -> str:
    return " ".join("".join(c if c.isprintable() else " " for c in text).split()).replace("`", "'")


def _delta(change: Change) -> str:
    """The differences of a changed release in words; top-level values by name."""
    if change.before is None or change.after is None:
        return ""
    before = change.before.values
    after = change.after.values
    keys = [key for key in sorted({*before, *after}) if before.get(key) != after.get(key)]
    parts = [f"values {', '.join(keys)}"] if keys else []
    if change.before.digest != change.after.digest:
        parts.append(f"chart from {change.before.version} ({change.before.digest[7:19]})")
    if change.before.evidence != change.after.evidence:
        parts.append(f"evidence from {change.before.evidence[:19]}")
    if change.before.causes != change.after.causes:
        parts.append(f"tasks {len(change.before.causes)} -> {len(change.after.causes)}")
    return f": {'; '.join(parts)}"
