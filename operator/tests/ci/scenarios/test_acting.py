"""Steps are done in their order, each outcome is waited for, and what was begun is taken back when one is not seen."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from kubernetes import client

from robotkube.delivery.tasks.core.task_description import read_task
from scenarios.runner.inputs import Plan
from scenarios.runner.observing.tasks import TaskWatch
from scenarios.runner.platform import listening
from scenarios.runner.playing import acting
from scenarios.runner.waiting import RunError
from scenarios.steps import read_steps

APPLICATION = {"status": {"sync": {"status": "Synced"}, "health": {"status": "Healthy"}}}


@dataclass
class ActingStage:
    """A cluster, a repository and its machines in memory; `doings` is what was done to them."""

    doings: list[str] = field(default_factory=list)
    found: dict[str, dict[str, Any]] = field(default_factory=dict)
    releases: dict[str, Any] = field(default_factory=dict)
    running: dict[str, Any] = field(default_factory=dict)
    bridge: Any = None
    heard: list[str] = field(default_factory=list)

    def task(self, namespace: str, name: str) -> Any:
        return self.found.get(f"{namespace}/{name}")

    def tasks(self) -> list[Any]:
        return list(self.found.values())

    def create_task(self, body: Mapping[str, Any]) -> None:
        key = f"{body['metadata']['namespace']}/{body['metadata']['name']}"
        self.doings.append(f"create {key}")
        conditions = [{"type": "Accepted", "status": "True", "reason": "Accepted", "message": ""}]
        self.found[key] = {**body, "status": {"conditions": conditions}}

    def delete_task(self, namespace: str, name: str) -> None:
        self.doings.append(f"delete {namespace}/{name}")
        self.found.pop(f"{namespace}/{name}", None)

    def kill(self, component: str) -> None:
        self.doings.append(f"kill {component}")

    def set_schedulable(self, node: str, schedulable: bool) -> None:
        self.doings.append(f"schedulable {node} {schedulable}")

    def applications(self) -> Mapping[str, Any]:
        return self.running

    def state(self, _: Any) -> str:
        return "the state"

    def pods(self, namespace: str) -> list[Any]:
        return [self.bridge] if namespace == "vehicle-00" and self.bridge else []

    def run_inside(self, namespace: str, pod: str, command: Sequence[str], seconds: float) -> str:
        assert seconds > float(command[-1]), "it ends by itself"
        self.doings.append(f"listen {namespace}/{pod} {' '.join(command[3:6])}")
        return "".join(f"{line}\n" for line in self.heard)

    def stop_node(self, name: str) -> None:
        self.doings.append(f"stop {name}")

    def start_node(self, name: str) -> None:
        self.doings.append(f"start {name}")


@pytest.fixture
def stage() -> ActingStage:
    return ActingStage()


@pytest.fixture
def actor(stage: ActingStage) -> acting.Actor:
    return acting.Actor(
        stage,  # type: ignore[arg-type]
        stage,
        releases=lambda: stage.releases,
        progress=lambda _: None,
        before_kill=lambda: stage.doings.append("note"),
    )


SUBMIT = {"namespace": "cloud-0", "name": "a", "application": "object-detection", "parameters": {"sensor": "x"}}


def test_steps_are_done_in_their_order_and_noted(actor: acting.Actor, stage: ActingStage) -> None:
    stage.releases, stage.running = {"edge-0/r": {}}, {"edge-0-r": APPLICATION}
    actor.perform(
        read_steps(
            [
                {"name": "one", "do": {"submit": SUBMIT}, "until": [{"task": "cloud-0/a", "status": "True"}]},
                {"name": "two", "until": [{"release": "edge-0/r", "is": "ready"}, {"tasks": "cloud-0", "at_least": 1}]},
                {"name": "three", "do": {"kill": "manager"}},
                {"name": "four", "do": {"cordon": "edge-0"}},
                {"name": "five", "do": {"uncordon": "edge-0"}},
                {"name": "six", "do": {"delete": "cloud-0/a"}, "until": [{"tasks": "cloud-0", "at_least": 0}]},
            ]
        )
    )
    assert stage.doings == [
        "create cloud-0/a",
        "note",
        "kill manager",
        "schedulable edge-0 False",
        "schedulable edge-0 True",
        "delete cloud-0/a",
    ]
    assert [(step.name, step.done is not None) for step in actor.done] == [
        (name, True) for name in ("one", "two", "three", "four", "five", "six")
    ]
    assert actor.done[0].what == "submits task cloud-0/a"
    assert actor.done[1].what == "waits"


HEARD = {"heard": "/vehicles/roadside_0/objects", "type": "geometry_msgs/msg/PoseArray", "at": "vehicle-00"}


def bridge(ready: str) -> client.V1Pod:
    conditions = [client.V1PodCondition(type="Ready", status=ready)]
    metadata = client.V1ObjectMeta(name="mqtt-bridge-x", labels={"app.kubernetes.io/name": "mqtt-bridge"})
    return client.V1Pod(metadata=metadata, status=client.V1PodStatus(phase="Running", conditions=conditions))


def test_messages_count_where_they_are_heard(actor: acting.Actor, stage: ActingStage) -> None:
    """In the agent's bridge, which every agent has that hears of others, once it is ready."""
    [step] = read_steps([{"name": "hears", "until": [{**HEARD, "at_least": 2}]}])
    [state] = step.until
    assert str(state) == "2 messages of /vehicles/roadside_0/objects heard on vehicle-00"
    for there, messages, holds in (("", 2, False), ("False", 2, False), ("True", 1, False), ("True", 2, True)):
        stage.bridge = bridge(there) if there else None
        stage.heard = [base64.b64encode(b"message").decode()] * messages
        assert actor._holds(state) is holds
    listened = "vehicle-00/mqtt-bridge-x /vehicles/roadside_0/objects geometry_msgs/msg/PoseArray 2"
    assert stage.doings == [f"listen {listened}"] * 2
    assert [bytes(message) for message in listening.messages("\n".join(stage.heard))] == [b"message"] * 2


def test_what_is_not_seen_ends_the_story_and_is_taken_back(actor: acting.Actor, stage: ActingStage) -> None:
    steps = [
        {"name": "submit", "do": {"submit": SUBMIT}},
        {"name": "stop", "do": {"stop": "edge-0"}},
        {"name": "never", "until": [{"task": "cloud-0/a", "reason": "Postponed"}], "seconds": 1},
        {"name": "not reached", "do": {"kill": "gate"}},
    ]
    with pytest.raises(RunError, match=r"step 'never': task cloud-0/a: Accepted=any Postponed"):
        actor.perform(replaced_bound(steps))
    assert stage.doings == ["create cloud-0/a", "stop edge-0", "start edge-0", "delete cloud-0/a"]
    assert [step.done is not None for step in actor.done] == [True, True, False]


def replaced_bound(steps: list[dict[str, Any]]) -> tuple[Any, ...]:
    return tuple(replace(step, seconds=0.0) for step in read_steps(steps))


@pytest.mark.parametrize(
    ("state", "releases", "running", "holds"),
    [
        ("main", {"a/b": {}}, {}, True),
        ("main", {}, {"a-b": APPLICATION}, False),
        ("ready", {"a/b": {}}, {"a-b": APPLICATION}, True),
        ("ready", {"a/b": {}}, {}, False),
        ("ready", {"a/b": {}}, {"a-b": {"status": {"sync": {"status": "OutOfSync"}}}}, False),
        ("absent", {}, {}, True),
        ("absent", {}, {"a-b": APPLICATION}, False),
        ("absent", {"a/b": {}}, {}, False),
    ],
)
def test_a_release_is_looked_for_on_main_and_in_the_cluster(
    actor: acting.Actor, stage: ActingStage, state: str, releases: Any, running: Any, holds: bool
) -> None:
    stage.releases, stage.running = releases, running
    steps = replaced_bound([{"name": "look", "until": [{"release": "a/b", "is": state}]}])
    if holds:
        actor.perform(steps)
    else:
        with pytest.raises(RunError, match=f"release a/b {state}"):
            actor.perform(steps)


def test_the_task_of_a_step_is_one_that_the_manager_reads() -> None:
    more = {"conflictPolicy": "Postpone", "priority": 900, "placement": {"roles": ["edge"]}}
    description = read_task(acting.task({**SUBMIT, **more}))
    assert (description.key, description.application, description.parameters) == (
        "cloud-0/a",
        "object-detection",
        {"sensor": "x"},
    )
    assert (description.conflict_policy, description.priority, description.placement.roles) == (
        "Postpone",
        900,
        ("edge",),
    )


def plan(number: int, **values: Any) -> Plan:
    empty = dict.fromkeys(("proposed", "merged", "observed", "pull_request", "commit"))
    lists: dict[str, Any] = dict.fromkeys(("tasks", "events", "changed", "created", "removed"), ())
    return Plan(**{"plan": f"p{number}", "subject": "s", "cause": "task", "started": number} | empty | lists | values)  # type: ignore[arg-type]


def test_plans_of_a_killed_manager_are_kept_and_completed() -> None:
    before = (plan(1, merged=5, observed=6, created=("a/b",)), plan(2, proposed=7, created=("c/d",)))
    after = (plan(2, merged=9, observed=10), plan(3))
    merged = acting.merge_plans(before, after)
    assert [one.plan for one in merged] == ["p1", "p2", "p3"]
    assert (merged[1].proposed, merged[1].merged, merged[1].created) == (7, 9, ("c/d",))


def test_a_plan_without_a_start_time_comes_first_and_takes_the_one_that_is_known() -> None:
    before = (plan(1), plan(2))
    after = (plan(3, started=None), plan(1, started=None, merged=5))
    merged = acting.merge_plans(before, after)
    assert [(one.plan, one.started) for one in merged] == [("p3", None), ("p1", 1), ("p2", 2)]


# the watch of the tasks -----------------------------------------------------------------------------------------------


def news(uid: str, *conditions: tuple[str, str, str], parent: str = "") -> dict[str, Any]:
    of_status = [
        {"type": kind, "status": status, "reason": reason, "message": "because"} for kind, status, reason in conditions
    ]
    spec = {"chain": {"parent": parent}} if parent else {}
    metadata = {"uid": uid, "namespace": "cloud-0", "name": "a"}
    return {"metadata": metadata, "spec": spec, "status": {"conditions": of_status}}


def test_a_task_s_life_is_noted_from_the_watch() -> None:
    watch = TaskWatch(None, lambda _: None)  # type: ignore[arg-type]
    accepted, postponed = ("Accepted", "True", "Accepted"), ("Accepted", "False", "Postponed")
    for kind, task in (
        ("ADDED", news("1", parent="cloud-0/b")),
        ("MODIFIED", news("1", postponed)),
        ("MODIFIED", news("1", postponed)),
        ("MODIFIED", news("1", accepted, ("Ready", "True", "Observed"))),
        ("DELETED", news("1", accepted)),
        ("ADDED", news("2")),
    ):
        watch.note(kind, task)
    first, second = watch.lives()
    assert (first.key, first.parent) == ("cloud-0/a", "cloud-0/b")
    assert [(condition.type, condition.reason) for condition in first.conditions] == [
        ("Accepted", "Postponed"),
        ("Accepted", "Accepted"),
        ("Ready", "Observed"),
    ]
    assert first.deleted
    assert first.deleted >= first.created
    assert second.deleted is None
    with pytest.raises(ValueError, match="ended the watch: ERROR"):
        watch.note("ERROR", news("3"))
