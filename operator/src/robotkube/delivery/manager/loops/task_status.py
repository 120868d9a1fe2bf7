"""Statuses of tasks, derived from main, from the last decisions and from what the cluster shows."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any

from robotkube.delivery.deployment.core.policies.edits import PATH as EDITS
from robotkube.delivery.deployment.core.releases import RELEASES, Release, application_name
from robotkube.delivery.manager.core.broken_links import BrokenLinks, link_faults
from robotkube.delivery.manager.core.changed_settings import SettingsProofs, refusals
from robotkube.delivery.manager.core.composition.inputs import Met, Refused
from robotkube.delivery.manager.core.conflicts import DemandOutcome, Postponed
from robotkube.delivery.manager.core.decision_history import with_decision
from robotkube.delivery.manager.core.observation import ApplicationState, PodState, ReleaseVerdict, judge_present
from robotkube.delivery.manager.core.pod_troubles import pod_troubles
from robotkube.delivery.manager.core.standing_demands import Asked, moment, stamp_of
from robotkube.delivery.manager.loops.proposals.plan_records import PlanRecord
from robotkube.delivery.tasks.core.refusal_outlooks import with_outlook
from robotkube.delivery.tasks.core.task_description import (
    EDITED_BY_HAND,
    HELD_BY_AGENT,
    LINK_BROKEN,
    MERGED,
    OBSTACLES,
    OLD_POD_UNREACHABLE,
    POSTPONED,
    PROPOSAL_REFUSED,
    PROPOSED,
    REFUSAL_REASONS,
    WAITING,
    StatusCondition,
    write_conditions,
)
from robotkube.delivery.tasks.ports.store import TaskStore
from robotkube.errors import InputError, RobotKubeError
from robotkube.foundation.documents.core.shortening import shortened
from robotkube.foundation.documents.core.times import time_text
from robotkube.foundation.kubernetes.core.objects import is_withdrawn, object_identity, object_key

PodsOf = Callable[[str], Sequence[PodState]]
"""The pods of a release (key)."""

MESSAGE_CHARACTERS_MAX = 4096
CLEARED: Mapping[str, Any] = dict.fromkeys(("plan", "pullRequest", "commit", "releases", "queue", "offloaded"))
UNDECIDED = {"Accepted": "Unknown", "Committed": "False"}  # conditions of a task that could not be decided yet
REPORTED_REASONS = frozenset({*REFUSAL_REASONS, PROPOSAL_REFUSED, EDITED_BY_HAND, LINK_BROKEN, *OBSTACLES})

WRITERS = 4
ALONE_MAX = 3  # so few statuses are written one after the other
PROGRESS_NS = 1_000_000_000  # how often mere messages of progress are written: a deployment has twenty in 5 s

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Situation:
    """The inputs from which statuses are derived. `outcomes` by task key; `decided` says what each task asked for then;
    `offloaded` are tasks that run elsewhere;
    `held` are refusals of the gate by task key; `waiting` says which agents hold changes of a task; `proposed` is the
    plan under decision; `committed` finds the newest plan on main that names a task; `edited` says who changed a
    release by hand that stays so, by path; `obstacle` is reason and message of what keeps every plan from main now;
    `broken` are links that bridges do not carry; `pods` gives those of a release (key); `proofs` says whether changed
    settings are at work."""

    outcomes: Mapping[str, DemandOutcome] = field(default_factory=dict)
    decided: Mapping[str, Asked] = field(default_factory=dict)
    offloaded: frozenset[str] = frozenset()
    held: Mapping[str, PlanRecord] = field(default_factory=dict)
    waiting: Mapping[str, str] = field(default_factory=dict)
    present: Mapping[str, Release] = field(default_factory=dict)
    applications: Mapping[str, ApplicationState] = field(default_factory=dict)
    proposed: PlanRecord | None = None
    committed: Callable[[str], PlanRecord | None] = lambda task: None
    edited: Mapping[str, str] = field(default_factory=dict)
    obstacle: tuple[str, str] | None = None
    broken: BrokenLinks = field(default_factory=dict)
    pods: PodsOf = lambda release: ()
    proofs: SettingsProofs = field(default_factory=lambda: SettingsProofs(lambda: 0))


@dataclass(frozen=True)
class _Written:
    """A status as it was written: of which object, since when."""

    identity: str
    status: dict[str, Any]
    at_ns: int


@dataclass(frozen=True)
class _Due:
    """A status to be written: the task's object, its conditions as values and as they go out, those that it had."""

    key: str
    document: Mapping[str, Any]
    conditions: Sequence[StatusCondition]
    status: dict[str, Any]
    before: Sequence[Mapping[str, Any]]


class StatusWriter:
    """The writer of tasks' statuses: it writes those that differ from what stands there."""

    def __init__(
        self,
        tasks: TaskStore,
        now_ns: Callable[[], int],
        broken: Callable[[], BrokenLinks] = dict,
        pods: PodsOf = lambda release: (),
    ) -> None:
        self._tasks = tasks
        self._broken = broken
        self._pods = pods
        self._now_ns = now_ns
        self._written: dict[str, _Written] = {}
        self._held_until_ns: int | None = None
        self._proofs = SettingsProofs(now_ns)

    def write(self, situation: Situation) -> None:
        """Bring the statuses of all tasks up to date; mere messages may be held back, see `seconds_until_due`."""
        situation = replace(situation, broken=self._broken(), pods=self._pods, proofs=self._proofs)
        documents = {object_key(d): d for d in self._tasks.tasks() if not is_withdrawn(d)}
        kept = self._written.items()
        self._written = {key: written for key, written in kept if written.identity == _identity(documents.get(key))}
        self._held_until_ns = None
        self._proofs.begin({release.key for release in situation.present.values()})
        due = [status for key, document in documents.items() if (status := self._due(key, document, situation))]
        if len(due) <= ALONE_MAX:
            for status in due:
                self._send(status)
        else:
            self._send_together(due)

    def seconds_until_due(self) -> float | None:
        """The seconds until a status that was held back is to be written; None: there is none."""
        moments = [moment for moment in (self._held_until_ns, self._proofs.until_ns) if moment is not None]
        return max(min(moments) - self._now_ns(), 0) / 1e9 if moments else None

    def _send_together(self, due: Sequence[_Due]) -> None:
        """Write several statuses at once: the API server answers each after milliseconds, and a storm brings
        hundreds."""
        with ThreadPoolExecutor(WRITERS) as pool:
            try:
                list(pool.map(self._send, due))
            except RobotKubeError:
                pool.shutdown(cancel_futures=True)
                raise

    def _due(self, key: str, document: Mapping[str, Any], situation: Situation) -> _Due | None:
        """The status of a task that is to be written; None when it does not differ from what stands there."""
        stamp = stamp_of(document)
        asked = situation.decided.get(key)
        outcome = situation.outcomes.get(key) if asked is not None and asked.stamp == stamp else None
        conditions, facts = derive(key, outcome, situation)
        if not conditions:
            return None
        generation = stamp[1]
        written = self._written.get(key)
        before = written.status if written else document.get("status") or {}
        now = datetime.fromtimestamp(self._now_ns() / 1e9, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        status = {
            "observedGeneration": generation,
            "conditions": write_conditions(conditions, before.get("conditions", []), generation, now),
            **facts,
            **_history(outcome, conditions[0], before.get("history", []), generation, now),
        }
        if all(before.get(name) == value for name, value in status.items()):
            return None
        if written and _is_progress(before, status) and self._is_too_early(written.at_ns):
            return None
        return _Due(key, document, conditions, status, before.get("conditions", []))

    def _is_too_early(self, since_ns: int) -> bool:
        """Return whether it is too early to write again; keeps the time when it will be. A clock put back holds
        nothing."""
        if not 0 <= self._now_ns() - since_ns < PROGRESS_NS:
            return False
        until = since_ns + PROGRESS_NS
        self._held_until_ns = min(until, self._held_until_ns or until)
        return True

    def _send(self, due: _Due) -> None:
        self._report(due.document, due.conditions, due.before)  # first: a status that stands is not compared again
        if self._patch(due.key, due.status):
            self._written[due.key] = _Written(object_identity(due.document), due.status, self._now_ns())
            fields = [f"task={due.key}", *(f"{c.type}={c.status}/{c.reason}" for c in due.conditions)]
            log.info("task %s", " ".join(fields))

    def _report(
        self, document: Mapping[str, Any], conditions: Sequence[StatusCondition], before: Sequence[Mapping[str, Any]]
    ) -> None:
        """Report new obstacles of a task as Events as well; the status does not depend on that."""
        known = {_event(c.get("type"), c.get("reason"), c.get("message")) for c in before}
        for condition in conditions:
            event = _event(condition.type, condition.reason, condition.message)
            if condition.reason not in REPORTED_REASONS or event in known:
                continue
            try:
                self._tasks.report_on_task(document, condition.reason, condition.message)
            except RobotKubeError as error:
                log.error("event not written task=%s reason=%s", object_key(document), error)

    def _patch(self, key: str, status: Mapping[str, Any]) -> bool:
        """Write one status; True when the API server refuses it, since that must not hold the others."""
        namespace, name = key.split("/")
        try:
            return self._tasks.patch_status(namespace, name, status)
        except InputError as error:
            log.error("status refused task=%s reason=%s", key, error)
            return True


def _history(
    outcome: DemandOutcome | None,
    accepted: StatusCondition,
    before: Sequence[Mapping[str, Any]],
    generation: int,
    now: str,
) -> dict[str, Any]:
    """The status field `history`; nothing while the task was not decided."""
    if outcome is None:
        return {}
    runs = outcome.runs if isinstance(outcome, Met) else ()
    return {"history": with_decision(before, generation, accepted.reason, runs, accepted.message, now)}


def _is_progress(before: Mapping[str, Any], after: Mapping[str, Any]) -> bool:
    """Return whether the same conditions stand for the same reasons, and only their messages differ."""
    return _without_messages(before) == _without_messages(after)


def _without_messages(status: Mapping[str, Any]) -> dict[str, Any]:
    conditions = [{key: value for key, value in c.items() if key != "message"} for c in status.get("conditions", [])]
    return {**status, "conditions": conditions}


def _event(kind: Any, reason: Any, message: Any) -> tuple[Any, ...]:
    """The parts by which an Event is new: for a task that waits, not its position."""
    return (kind, reason) if reason == POSTPONED else (kind, reason, message)


def _identity(document: Mapping[str, Any] | None) -> str | None:
    return object_identity(document) if document is not None else None


def derive(
    key: str, outcome: DemandOutcome | None, situation: Situation
) -> tuple[list[StatusCondition], dict[str, Any]]:
    """The conditions and the other fields of a task's status; nothing when the task, as it is now, was not decided
    yet."""
    if outcome is None:
        obstacle = _obstacle(situation)
        return [StatusCondition(kind, status, *obstacle) for kind, status in UNDECIDED.items() if obstacle], {}
    if isinstance(outcome, Refused):
        message = with_outlook(outcome.reason, outcome.message, MESSAGE_CHARACTERS_MAX)
        return [StatusCondition("Accepted", "False", outcome.reason, message)], dict(CLEARED)
    if isinstance(outcome, Postponed):
        queue = {"since": time_text(outcome.since_ns), "until": moment(outcome.until_ns), "position": outcome.position}
        return [StatusCondition("Accepted", "False", POSTPONED, _bounded(outcome.message))], {**CLEARED, "queue": queue}
    accepted = StatusCondition("Accepted", "True", "Accepted", _bounded("; ".join(outcome.choices)))
    committed, record = _committed(key, outcome, situation)
    verdicts = _verdicts(outcome, situation)
    conditions = [accepted, committed]
    if committed.status == "True":
        faults = link_faults(outcome.links, situation.broken)
        conditions += [_synced(verdicts), _ready(record, faults, _unproven(outcome, verdicts, situation))]
    offloaded = True if key in situation.offloaded else None
    return conditions, {"releases": list(outcome.releases), "queue": None, "offloaded": offloaded, **_facts(record)}


def _bounded(text: str) -> str:
    return shortened(text, MESSAGE_CHARACTERS_MAX)


def _facts(record: PlanRecord | None) -> dict[str, Any]:
    if record is None:
        return {}
    facts: dict[str, Any] = {"plan": record.id}
    if record.commit and record.on_main:
        facts["commit"] = record.commit
    if record.pull_request is not None:
        facts["pullRequest"] = {"number": record.pull_request, "url": record.url}
    return facts


def _committed(key: str, outcome: Met, situation: Situation) -> tuple[StatusCondition, PlanRecord | None]:
    if key in situation.waiting:
        return StatusCondition("Committed", "False", HELD_BY_AGENT, _bounded(situation.waiting[key])), None
    releases = [situation.present.get(f"{RELEASES}/{name}.yaml") for name in outcome.releases]
    if releases and all(_answers(release, key, situation) for release in releases):
        record = situation.committed(key)
        number = f" by pull request {record.pull_request}" if record and record.pull_request is not None else ""
        commit = f"commit {record.commit[:12]}" if record and record.commit else "its releases are"
        return StatusCondition("Committed", "True", MERGED, f"{commit} on main{number}"), record
    held = situation.held.get(key)
    if held is not None:
        return StatusCondition("Committed", "False", PROPOSAL_REFUSED, _bounded(held.error or "")), held
    return _waiting(key, outcome, situation)


def _answers(release: Release | None, key: str, situation: Situation) -> bool:
    """Return whether main's release is there for what the task asks now, not for the parameters that it had before."""
    asked = situation.decided.get(key)
    return release is not None and asked is not None and any(map(asked.answered_by, release.causes))


def _obstacle(situation: Situation) -> tuple[str, str] | None:
    """The obstacle that holds every plan, as reason and message; None when there is none."""
    if situation.obstacle:
        return situation.obstacle[0], _bounded(situation.obstacle[1])
    proposed = situation.proposed
    return (proposed.waits[0], _bounded(proposed.waits[1])) if proposed is not None and proposed.waits else None


def _waiting(key: str, outcome: Met, situation: Situation) -> tuple[StatusCondition, PlanRecord | None]:
    """The condition Committed of a task whose plan is not on main: what it waits for (forge, gate, a person, or the
    plan before it), and its own plan."""
    proposed = situation.proposed
    own = proposed if proposed is not None and key in proposed.tasks else None
    obstacle = _obstacle(situation)
    if obstacle:
        return StatusCondition("Committed", "False", *obstacle), own
    if own is not None:
        number = f"pull request {own.pull_request}" if own.pull_request is not None else "its pull request"
        return StatusCondition("Committed", "False", PROPOSED, f"{number} waits for the gate"), own
    if edited := _edited(key, outcome, situation):
        return StatusCondition("Committed", "False", EDITED_BY_HAND, _bounded(edited)), None
    return StatusCondition("Committed", "False", WAITING, "waits for the plan before it"), None


def _edited(key: str, outcome: Met, situation: Situation) -> str:
    """The releases of the task that people removed or changed, by which commits, and what to do; empty when none."""
    words = []
    for path in (f"{RELEASES}/{name}.yaml" for name in outcome.releases):
        release = situation.present.get(path)
        who = situation.edited.get(path)
        if who and not _answers(release, key, situation):
            words.append(f"{path} was {'removed' if release is None else 'changed'} by {who}")
    advice = f"{EDITS} respects that: withdraw the task, bring the release back, or write `edits: revert` there"
    return f"{'; '.join(words)}. {advice}" if words else ""


def _verdicts(outcome: Met, situation: Situation) -> dict[str, ReleaseVerdict]:
    verdicts: dict[str, ReleaseVerdict] = {}
    for key in outcome.releases:
        release = situation.present.get(f"{RELEASES}/{key}.yaml")
        application = situation.applications.get(application_name(*key.split("/")))
        verdicts[key] = judge_present(application, release.plan if release else "")
    return verdicts


def _synced(verdicts: Mapping[str, ReleaseVerdict]) -> StatusCondition:
    missing = [f"{key}: {verdict.message}" for key, verdict in verdicts.items() if not verdict.synced]
    if missing:
        return StatusCondition("Synced", "False", "Progressing", _bounded("; ".join(missing)))
    return StatusCondition("Synced", "True", "Applied", "Argo CD compared and applied every release")


def _unproven(outcome: Met, verdicts: Mapping[str, ReleaseVerdict], situation: Situation) -> list[str]:
    """Why releases are not ready: what is missing, what their pods say, and changed settings that are not shown to be
    at work. Bridges say themselves what they do not carry."""
    bridges = {release for release, _, _ in outcome.links}
    words = []
    for key, verdict in verdicts.items():
        application = situation.applications.get(application_name(*key.split("/")))
        pods = situation.pods(key)
        if not verdict.done:
            troubles = [*pod_troubles(pods), *(refusals(application, pods) if verdict.synced else ())]
            words.append("; ".join([f"{key}: {verdict.message}", *troubles]))
        elif key not in bridges and (missing := situation.proofs.missing(key, application, pods)):
            words.append(f"{key}: {missing}")
    return words


def _ready(record: PlanRecord | None, faults: Sequence[str], missing: Sequence[str]) -> StatusCondition:
    if missing:
        return StatusCondition("Ready", "False", "Progressing", _bounded("; ".join(missing)))
    if faults:
        return StatusCondition("Ready", "False", LINK_BROKEN, _bounded("; ".join(faults)))
    if record is not None and record.unreachable:
        names = ", ".join(record.unreachable)
        return StatusCondition(
            "Ready", "True", OLD_POD_UNREACHABLE, _bounded(f"observed, but on dead nodes there are {names}")
        )
    return StatusCondition("Ready", "True", "Observed", "every release is observed")
