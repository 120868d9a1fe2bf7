"""Constraints of the manager's decisions: scopes of manager and operators, chains of tasks, holds of devices."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from robotkube.delivery.deployment.core.policies.links import LinkConsents
from robotkube.delivery.deployment.core.releases import Release, Tree
from robotkube.delivery.manager.core.chains import ChainTask, judge, lineage
from robotkube.delivery.manager.core.composition.composer import Met, Refused
from robotkube.delivery.manager.core.conflicts import DemandOutcome
from robotkube.delivery.manager.core.held_changes import held, waiting_tasks
from robotkube.delivery.manager.core.placement.enrollment import enrolled_agents
from robotkube.delivery.manager.core.placement.placement import Agent, Fleet
from robotkube.delivery.manager.core.placement.scopes import (
    Operators,
    Scope,
    check_application,
    check_releases,
    own_releases,
    own_sources,
    scoped_fleet,
)
from robotkube.delivery.manager.core.plans import Change
from robotkube.delivery.tasks.core.holds import DeviceHold
from robotkube.delivery.tasks.core.task_description import TaskDescription
from robotkube.errors import RefusalError

Tasks = Mapping[str, TaskDescription]

log = logging.getLogger(__name__)


class Constraints:
    """What one manager must stay within: scopes, chains of tasks, held changes; `agents` are all that are declared."""

    def __init__(self, agents: Sequence[Agent], operators: Operators) -> None:
        self._agents = agents
        self._enrolled: tuple[Mapping[str, str], Sequence[Agent]] | None = None
        self._operators = operators
        self._unbounded = operators.unbounded
        self._names = {agent.namespace: agent.name for agent in agents}
        self._logged: Mapping[str, DeviceHold] = {}
        self._fleet: tuple[Fleet, LinkConsents, Fleet] | None = None
        self._own: tuple[Tree, Tree] | None = None
        self.waiting_tasks: Mapping[str, str] = {}
        self.holds_end_ns: int | None = None

    def agents(self, enrolled: Mapping[str, str]) -> Sequence[Agent]:
        """The agents that are there while main enrolls these; the same object for the same mapping."""
        if self._enrolled is None or self._enrolled[0] is not enrolled:
            self._enrolled = enrolled, enrolled_agents(self._agents, enrolled)
        return self._enrolled[1]

    def fleet(self, whole: Fleet, consents: LinkConsents) -> Fleet:
        """The agents that this manager answers for, with their nodes, and what may be heard of others; the same object
        for the same fleet and consents."""
        if self._fleet is None or self._fleet[0] is not whole or self._fleet[1] != consents:
            borders = self._operators.borders(consents)
            self._fleet = whole, consents, scoped_fleet(whole, self._operators.manager, borders)
        return self._fleet[2]

    def own(self, tree: Tree) -> Tree:
        """The part of main that this manager answers for; it leaves everything else as it is. The same object for the
        same tree."""
        scope = self._operators.manager
        if not scope.is_narrow:
            return tree
        if self._own is None or self._own[0] is not tree:
            releases = own_releases(tree.releases, self._agents, scope)
            own = replace(tree, releases=releases, sources=own_sources(tree.sources, self._agents, scope))
            self._own = tree, own
        return self._own[1]

    def refused_before(
        self, tasks: Sequence[TaskDescription], live: Tasks, gone: Mapping[str, str], releases: Iterable[Release]
    ) -> dict[str, Refused]:
        """The tasks that need not be composed: out of their chain, or for an application out of their scope. `live` are
        all that stand, `gone` says why others do not, `releases` are main's."""
        refusals = self._out_of_chain(live, gone, releases)
        for task in () if self._unbounded else tasks:
            if task.application and task.key not in refusals:
                refusal = self._outside(task, live, task.application, ())
                refusals |= {task.key: refusal} if refusal else {}
        return {task.key: refusals[task.key] for task in tasks if task.key in refusals} if refusals else {}

    def refused_after(
        self,
        tasks: Sequence[TaskDescription],
        live: Tasks,
        gone: Mapping[str, str],
        releases: Iterable[Release],
        outcomes: Mapping[str, DemandOutcome],
    ) -> dict[str, Refused]:
        """The tasks that have to go after all: they led out of their scope, or a task above them was refused."""
        refusals: dict[str, Refused] = {}
        for task in () if self._unbounded else tasks:
            outcome = outcomes.get(task.key)
            refusal = None
            if isinstance(outcome, Met):
                places = [name.partition("/")[0] for name in outcome.releases]
                refusal = self._outside(task, live, outcome.application or task.application, places)
            refusals |= {task.key: refusal} if refusal else {}
        chains = self._out_of_chain(live, {**gone, **{key: r.message for key, r in refusals.items()}}, releases)
        if not refusals and not chains:
            return {}
        return {task.key: r for task in tasks if (r := refusals.get(task.key) or chains.get(task.key))}

    def _outside(
        self, task: TaskDescription, live: Tasks, application: str, namespaces: Sequence[str]
    ) -> Refused | None:
        try:
            scope = self._scope(task, live)
            check_application(scope, task.key, application)
            check_releases(scope, task.key, [self._names.get(namespace, namespace) for namespace in namespaces])
        except RefusalError as error:
            return Refused(error.reason, error.message)
        return None

    def _scope(self, task: TaskDescription, live: Tasks) -> Scope:
        if not self._operators.declared:
            return self._operators.manager
        line = lineage(task.key, _chain({**live, task.key: task})) if task.parent else ()
        return self._operators.scope([link.namespace for link in line] or [task.namespace])

    def _out_of_chain(self, live: Tasks, gone: Mapping[str, str], releases: Iterable[Release]) -> dict[str, Refused]:
        if not any(task.parent for task in live.values()):
            return {}
        refusals = judge(_chain(live), gone, releases)
        return {key: Refused(refusal.reason, refusal.message) for key, refusal in refusals.items()}

    def waits(self, changes: Sequence[Change], holds: Iterable[DeviceHold], now_ns: int) -> Mapping[str, str]:
        """The holds that each task would wait for, in words, if exactly these changes were wanted; changes nothing
        here."""
        return waiting_tasks(changes, held(changes, holds, self._names, now_ns)[1])

    def unheld(self, changes: tuple[Change, ...], holds: Iterable[DeviceHold], now_ns: int) -> tuple[Change, ...]:
        """The changes that no device holds. `waiting_tasks` says of the others' tasks what they wait for,
        `holds_end_ns` when the first of the holds that matter ends (None: none does)."""
        unheld, waiting = held(changes, holds, self._names, now_ns)
        self.waiting_tasks = waiting_tasks(changes, waiting)
        self.holds_end_ns = min((hold.until_ns for hold in waiting.values()), default=None)
        if waiting != self._logged:
            for path, hold in waiting.items():
                log.info("change waits path=%s agent=%s reason=%r", path, hold.agent, hold.text)
            self._logged = waiting
        return unheld


def _chain(live: Tasks) -> dict[str, ChainTask]:
    return {key: ChainTask(t.created, key, t.namespace, t.parent) for key, t in live.items()}
