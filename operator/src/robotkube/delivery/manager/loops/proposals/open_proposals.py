"""Open proposals across processes: one that does what is wanted now is taken over, an unwanted one is closed.

A process that begins to lead finds the open pull requests of the one before it: the one that does exactly what would be
proposed now is taken over, all others are closed. A proposal whose tasks were all withdrawn or changed is closed, too.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from typing import Any

from robotkube.delivery.deployment.core.commit_messages import read_message
from robotkube.delivery.manager.core.plans import Plan, answered_and_withdrawn
from robotkube.delivery.tasks.core.task_description import TaskDescription
from robotkube.errors import InputError
from robotkube.foundation.forge.ports.pull_requests import Forge, PullRequest
from robotkube.foundation.forge.ports.repositories import DeploymentRepository
from robotkube.foundation.kubernetes.core.objects import is_withdrawn, object_identity, object_key

DIGITS = 6  # of a plan's id: what it does, on which base

log = logging.getLogger(__name__)


class OpenProposals:
    """Open pull requests of the manager's account `name`."""

    def __init__(self, deployment: DeploymentRepository, forge: Forge, name: str) -> None:
        self._deployment = deployment
        self._forge = forge
        self._name = name

    def find(self, plan: Plan | None) -> tuple[PullRequest, str] | None:
        """The pull request that does what `plan` does, on the same base, and its plan's id; all others are closed."""
        match = None
        for pull in self._forge.pull_requests("open", self._name):
            identifier = self._same(pull, plan) if match is None and plan is not None else None
            if identifier is not None:
                match = (pull, identifier)
            else:
                self.close(pull.number, "the manager began anew, and does not want this any more")
        return match

    def _same(self, pull: PullRequest, plan: Plan) -> str | None:
        """The plan's id in the proposed commit; None when it does not do what `plan` does. The forge does not have
        it."""
        try:
            commit = self._deployment.proposal(pull.number)
            identifier = read_message(commit.message).plan
        except InputError:
            return None
        same = commit.id == pull.head and commit.parents == (plan.base,)
        return identifier if same and identifier[-DIGITS:] == plan.id[-DIGITS:] else None

    def close(self, number: int, why: str) -> None:
        """Comment why and close; nothing when the gate was faster."""
        try:
            self._forge.comment(number, f"Superseded: {why}.\n")
            self._forge.close(number)
        except InputError as error:
            log.info("proposal not closed pull_request=%d reason=%s", number, error)


def asked_for(plan: Plan, tasks: Mapping[str, TaskDescription]) -> dict[str, str]:
    """The parts of tasks that a plan answers, by task; empty for a plan that does more than answer tasks."""
    come, go = answered_and_withdrawn(plan.changes)
    if go or plan.message.kinds or any(cause.task not in tasks for cause in come):
        return {}
    return {cause.task: _answered(tasks[cause.task].identity, tasks[cause.task].generation) for cause in come}


def superseded(asked: Mapping[str, str], documents: Iterable[Mapping[str, Any]]) -> bool:
    """Return whether none of the tasks stands as it was asked for any more."""
    now = {
        object_key(d): _answered(object_identity(d), int(d["metadata"].get("generation", 1)))
        for d in documents
        if not is_withdrawn(d)
    }
    return bool(asked) and all(now.get(task) != answered for task, answered in asked.items())


def _answered(identity: str, generation: int) -> str:
    return f"{identity} {generation}"
