"""Does the steps of a story: submits and withdraws tasks, kills what the platform runs on, waits for what follows."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from robotkube.foundation.documents.core.times import time_text
from scenarios.runner.inputs import Plan, StepDone
from scenarios.runner.platform import listening
from scenarios.runner.platform.access import Access
from scenarios.runner.waiting import RunError, wait_for
from scenarios.steps import ABSENT, MAIN, Heard, ReleaseState, State, Step, TaskCount, TaskState

POLL_SECONDS = 0.5
REQUESTER = "operator-team/scenario"


class Machines(Protocol):
    """What can be done to the machines of nodes, where the cluster made them."""

    def stop_node(self, name: str) -> None:
        """End a node's machine with everything on it."""
        ...

    def start_node(self, name: str) -> None:
        """Let a stopped node come back."""
        ...


@dataclass
class Actor:
    """Does steps in their order. `machines` is None where steps do nothing to them; `nodes` are the names that nodes of
    the scenario have on this cluster, where they differ. `releases` gives main's releases as they are now;
    `before_kill` is called before something of the platform is killed, to save what only its memory holds."""

    access: Access
    machines: Machines | None
    releases: Callable[[], Mapping[str, Any]]
    progress: Callable[[str], None]
    before_kill: Callable[[], None] = lambda: None
    nodes: Mapping[str, str] = field(default_factory=dict)
    done: list[StepDone] = field(default_factory=list)
    _stopped: list[str] = field(default_factory=list)
    _submitted: list[str] = field(default_factory=list)

    def perform(self, steps: Sequence[Step]) -> None:
        """All steps. RunError names the first one whose outcome was not seen; what was begun is taken back then."""
        try:
            for step in steps:
                self._step(step)
        finally:
            self._take_back()

    def _step(self, step: Step) -> None:
        began = time.time_ns()
        seen = False
        try:
            self._await(step, step.when)
            if step.action:
                self.progress(f"{step.name}: {describe(step)}")
                getattr(self, f"_{step.action}")(step.given)
            self._await(step, step.until)
            seen = True
        finally:
            self.done.append(StepDone(step.name, describe(step), began, time.time_ns() if seen else None))

    def _await(self, step: Step, states: Sequence[State]) -> None:
        for state in states:

            def reached(state: State = state) -> bool:
                return self._holds(state)

            wait_for(f"step {step.name!r}: {state}", step.seconds, reached, lambda: self.access.state([]), POLL_SECONDS)

    def _holds(self, state: State) -> bool:
        if isinstance(state, TaskState):
            return _conditions_hold(self.access.task(*state.task.split("/", 1)), state)
        if isinstance(state, TaskCount):
            tasks = [task for task in self.access.tasks() if task["metadata"]["namespace"] == state.namespace]
            accepted = [task for task in tasks if _condition(task, "Accepted").get("status") == "True"]
            return len(accepted) >= state.at_least if state.at_least else not tasks
        if isinstance(state, Heard):
            messages = listening.heard(self.access, state.agent, state.topic, state.type_name, state.at_least)
            return len(messages) >= state.at_least
        return self._release_is(state)

    def _release_is(self, state: ReleaseState) -> bool:
        on_main = state.release in self.releases()
        if state.state == MAIN:
            return on_main
        application = self.access.applications().get(state.release.replace("/", "-"))
        if state.state == ABSENT:
            return not on_main and application is None
        status = (application or {}).get("status", {})
        words = status.get("sync", {}).get("status"), status.get("health", {}).get("status")
        return on_main and words == ("Synced", "Healthy")

    def _take_back(self) -> None:
        """Nodes that were stopped start again, tasks that are left are withdrawn: the next run begins as this one."""
        for node in list(self._stopped):
            self._start(node)
        for key in self._submitted:
            self.access.delete_task(*key.split("/", 1))

    def _submit(self, given: Mapping[str, Any]) -> None:
        key = f"{given['namespace']}/{given['name']}"
        self.access.create_task(task(given))
        self._submitted.append(key)

    def _delete(self, key: str) -> None:
        self.access.delete_task(*key.split("/", 1))
        self._submitted = [one for one in self._submitted if one != key]

    def _kill(self, component: str) -> None:
        self.before_kill()
        self.access.kill(component)

    def _cordon(self, node: str) -> None:
        self.access.set_schedulable(self.nodes.get(node, node), False)

    def _uncordon(self, node: str) -> None:
        self.access.set_schedulable(self.nodes.get(node, node), True)

    def _stop(self, node: str) -> None:
        self._owned().stop_node(node)
        self._stopped.append(node)

    def _start(self, node: str) -> None:
        self._owned().start_node(node)
        self._stopped = [one for one in self._stopped if one != node]

    def _owned(self) -> Machines:
        if self.machines is None:
            raise RunError("the machines of the nodes are others'")
        return self.machines

    def _wait(self, seconds: float) -> None:
        time.sleep(seconds)


def describe(step: Step) -> str:
    """A step's action, in few words."""
    if not step.action:
        return "waits"
    if step.action == "submit":
        return f"submits task {step.given['namespace']}/{step.given['name']}"
    words = {"delete": "withdraws task", "kill": "kills the", "wait": "waits, in s:"}
    return f"{words.get(step.action, step.action + 's node')} {step.given}"


def task(given: Mapping[str, Any]) -> dict[str, Any]:
    """The TaskDescription of a step: its fields, with a requester and an event of its own where it names none."""
    name = given["name"]
    spec = {key: value for key, value in given.items() if key not in ("namespace", "name")}
    token = uuid.uuid4().hex
    now = time_text(time.time_ns())
    event = {"rule": "scenario", "id": token, "trace": token, "time": now}
    return {
        "apiVersion": "robotkube.io/v1alpha1",
        "kind": "TaskDescription",
        "metadata": {"namespace": given["namespace"], "name": name},
        "spec": {"requester": REQUESTER, "event": event, "reason": "a step of the scenario", **spec},
    }


def _condition(known: Mapping[str, Any], kind: str) -> Mapping[str, Any]:
    conditions = known.get("status", {}).get("conditions", [])
    return next((condition for condition in conditions if condition["type"] == kind), {})


def _conditions_hold(known: Mapping[str, Any] | None, state: TaskState) -> bool:
    condition = _condition(known or {}, state.condition)
    wanted = {"status": state.status, "reason": state.reason}
    return bool(condition) and all(not word or condition.get(key) == word for key, word in wanted.items())


def merge_plans(earlier: Sequence[Plan], later: Sequence[Plan]) -> tuple[Plan, ...]:
    """The plans of two answers of the manager, before and after it was restarted: by id, the later answer first, its
    gaps filled from the earlier."""
    known = {plan.plan: plan for plan in earlier}
    for plan in later:
        before = known.get(plan.plan)
        known[plan.plan] = _filled(plan, before) if before else plan
    return tuple(sorted(known.values(), key=lambda plan: plan.started or 0))  # without times: from before the manager


def _filled(plan: Plan, before: Plan) -> Plan:
    values = {name: getattr(before, name) if value in (None, ()) else value for name, value in vars(plan).items()}
    return Plan(**values)
