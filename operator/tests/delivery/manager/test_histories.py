"""Random histories of tasks, nodes, people, gate and manager: after each, Git is what the ledger says, the cluster is
what Git says, no release is an orphan, and no demand is lost.

The model knows only this: which tasks stand, how many recorders the cloud has room for, and which the gate refuses.
"""

from __future__ import annotations

import copy
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule, run_state_machine_as_test

from robotkube.delivery.deployment.core.releases import Release, read_tree
from robotkube.delivery.manager.core.placement.capacity import Resources
from robotkube.delivery.manager.core.placement.placement import NodeState
from robotkube.delivery.manager.core.standing_demands import moment
from robotkube.delivery.manager.loops.reconciler import APPLICATIONS, DEPLOYMENT, NODES, TASKS
from robotkube.delivery.tasks.core.task_description import (
    NO_CAPABLE_NODE,
    PREEMPTED,
    QUEUE_TOO_LONG,
    REASONS,
    SETTLED_REASONS,
)
from robotkube.foundation.forge.ports.pull_requests import PullRequest
from robotkube.foundation.kubernetes.core.annotations import RENEWED_ANNOTATION
from robotkube.testing.forges import MemoryForge, MemoryRepository
from tests.stages.delivery.manager.manager_in_memory import START_NS, Stage
from tests.stages.examples import EXAMPLES

VEHICLES = 3
ROOM = 2  # recorders that fit onto the cloud's node beside what always runs there
PAIRS = [["vehicle-00", "vehicle-01"], ["vehicle-01", "vehicle-02"], ["vehicle-00", "vehicle-02"]]
NAMES = ["a", "b", "c", "d", "e"]
QUIET_TURNS_MAX = 12
SECOND = 1_000_000_000


def template(folder: Path) -> Stage:
    """One stage for all histories: the initial configuration runs, and the cloud's node has room for ROOM recorders."""
    stage = Stage(folder, VEHICLES)
    stage.settle()
    always = sum(release.namespace == "cloud-0" for release in stage.releases().values())
    room = Resources(30 * (always + ROOM), 2**40)
    stage.cluster.machines = [
        replace(node, allocatable=room if node.name == "cloud-0" else None) for node in stage.cluster.machines
    ]
    return stage


class HistoryStage(Stage):
    """A stage of its own that begins where the template is."""

    template: ClassVar[Stage]

    def __init__(self) -> None:
        first = self.template
        self.verifier, self.settings, self.catalogue = first.verifier, first.settings, first.catalogue
        self.leadership, self.argocd = copy.deepcopy(first.leadership), copy.deepcopy(first.argocd)
        self.cluster, self.tasks = copy.deepcopy(first.cluster), copy.deepcopy(first.tasks)
        known = first.repository
        self.repository = MemoryRepository(dict(known.commits), dict(known.trees), known.tip)
        self.forge = MemoryForge(self.repository)
        self.seconds = first.seconds
        self.manager = self.start()

    @property
    def now_ns(self) -> int:
        return START_NS + int(self.seconds * 1e9)


@dataclass
class Entry:
    """What the model knows of a task: when its lease ends, whether the gate refuses it, whether it may have met a
    conflict or a missing node in its present generation."""

    pair: list[str]
    priority: int
    policy: str
    lease_seconds: int | None
    begun: int
    refused_by_gate: bool = False
    in_trouble: bool = False

    def stands(self, now_ns: int) -> bool:
        return self.lease_seconds is None or self.begun * SECOND + self.lease_seconds * SECOND > now_ns


TASK = st.fixed_dictionaries(
    {
        "name": st.sampled_from(NAMES),
        "pair": st.sampled_from(PAIRS),
        "priority": st.sampled_from([0, 100, 500]),
        "policy": st.sampled_from(["Reject", "Postpone", "Preempt", "Offload"]),
        "lease": st.sampled_from([None, None, 5, 30]),
        "refused": st.integers(0, 9).map(lambda drawn: drawn == 7),
    }
)


class Histories(RuleBasedStateMachine):
    """Rules are what may happen; nothing is checked before the manager has had its turns."""

    def __init__(self) -> None:
        super().__init__()
        self.stage = HistoryStage()
        self.stage.forge.decide = self.decide
        self.model: dict[str, Entry] = {}
        self.away: dict[str, NodeState] = {}
        self.gate_away = False

    # -- what may happen ----------------------------------------------------------------------------------------

    @rule(drawn=st.lists(TASK, min_size=1, max_size=4))
    def tasks_are_created(self, drawn: list[dict[str, Any]]) -> None:
        for one in drawn:
            if f"cloud-0/{one['name']}" not in self.model:
                self.create(**one)

    def create(self, name: str, pair: Any, priority: int, policy: str, lease: int | None, refused: bool) -> None:
        extra: dict[str, Any] = {"lease": {"seconds": lease}} if lease else {}
        extra |= {"queue": {"secondsMax": 20}} if policy == "Postpone" else {}
        event = {"rule": "near", "id": f"event-{name}", "trace": "a" * 32, "time": moment(self.stage.now_ns)}
        spec: dict[str, Any] = {"requester": "someone", "event": event}
        spec |= {"application": "pose-point-cloud-recording"}
        spec |= {"parameters": {"vehicles": pair}, "priority": priority, "conflictPolicy": policy, **extra}
        self.stage.tasks.create("cloud-0", name, spec, moment(self.stage.now_ns))
        self.model[f"cloud-0/{name}"] = Entry(pair, priority, policy, lease, self.stage.now_ns // SECOND, refused)

    @precondition(lambda self: self.model)
    @rule(data=st.data(), what=st.sampled_from(["change", "renew", "delete", "delete"]), pair=st.sampled_from(PAIRS))
    def a_task_changes(self, data: st.DataObject, what: str, pair: list[str]) -> None:
        key = data.draw(st.sampled_from(sorted(self.model)))
        if what == "delete":
            self.stage.tasks.delete(key)
            del self.model[key]
        elif what == "renew":
            self.stage.tasks.annotate(key, RENEWED_ANNOTATION, moment(self.stage.now_ns))
            self.model[key].begun = self.stage.now_ns // SECOND
        else:
            self.stage.tasks.change(key, parameters={"vehicles": pair})
            self.model[key] = replace(self.model[key], pair=pair, refused_by_gate=False, in_trouble=False)

    @rule(seconds=st.sampled_from([1, 7, 25]))
    def time_passes(self, seconds: int) -> None:
        self.stage.seconds += seconds

    @rule(name=st.sampled_from(["cloud-0", "vehicle-00", "vehicle-02"]))
    def a_node_goes_or_comes_back(self, name: str) -> None:
        machines = self.stage.cluster.machines
        if name in self.away:
            machines.append(self.away.pop(name))
        else:
            self.away[name] = next(node for node in machines if node.name == name)
            machines.remove(self.away[name])
        self.stage.manager.wake(NODES)

    @rule(what=st.sampled_from(["manager", "gate", "gate", "removal", "other file"]), which=st.integers(0, 20))
    def somebody_intervenes(self, what: str, which: int) -> None:
        """The manager starts anew; the gate goes or comes back; a person removes a release, or writes another file."""
        stage = self.stage
        paths = sorted(self.stage.releases())
        if what == "manager":
            stage.manager = stage.start()
        elif what == "gate":
            self.gate_goes_or_comes_back()
        elif what == "removal" and paths:
            stage.repository.push({paths[which % len(paths)]: None})
            stage.manager.wake(DEPLOYMENT)
        else:
            stage.repository.push({"README.md": str(stage.seconds)})
            stage.manager.wake(DEPLOYMENT)

    def gate_goes_or_comes_back(self) -> None:
        self.gate_away = not self.gate_away
        if not self.gate_away:
            for pull in [p for p in self.stage.forge.pulls.values() if p.state == "open"]:
                self.decide(pull)

    @rule(steps=st.integers(1, 3))
    def manager_takes_some_steps(self, steps: int) -> None:
        self.note_trouble()
        self.stage.go(steps)

    # -- what must hold -------------------------------------------------------------------------------------------

    @rule()
    def everything_comes_to_rest(self) -> None:
        if self.gate_away:
            self.gate_goes_or_comes_back()
        self.come_to_rest()
        self.check()

    def teardown(self) -> None:
        self.everything_comes_to_rest()

    @invariant()
    def trouble_is_noted(self) -> None:
        self.note_trouble()

    def note_trouble(self) -> None:
        """Whoever stands while there are more demands than room, or while a node is missing, may meet a conflict."""
        now = self.stage.now_ns
        pairs = {tuple(entry.pair) for entry in self.model.values() if entry.stands(now)}
        for entry in self.model.values():
            entry.in_trouble |= len(pairs) > ROOM or bool({"cloud-0", *entry.pair} & set(self.away))

    def come_to_rest(self) -> None:
        """Turns until nothing happens any more, the last steps of each without time passing."""
        stage = self.stage
        for _ in range(QUIET_TURNS_MAX):
            before = stage.repository.tip, len(stage.forge.pulls)
            stage.go(3, wake=TASKS)
            stage.cluster.settle(stage.releases())
            stage.go(1, wake=APPLICATIONS)
            stage.go(2, seconds=0.0)
            # One that the gate has refused in this turn changes nothing on main, and has to be read still.
            same = (stage.repository.tip, len(stage.forge.pulls)) == before
            if same and not any(p.state == "open" for p in stage.forge.pulls.values()):
                break
        else:
            raise AssertionError(f"no rest after {QUIET_TURNS_MAX} turns")
        self.note_trouble()

    def decide(self, pull: PullRequest) -> None:
        """The gate: away, or against tasks that main does not answer yet and that the model says it refuses."""
        repository, forge = self.stage.repository, self.stage.forge
        if self.gate_away:
            return
        before, after = (causes(repository.trees[commit]) for commit in (repository.tip, pull.head))
        poisoned = {key for key, entry in self.model.items() if entry.refused_by_gate}
        if poisoned & (after - before):
            forge.refuse(pull, "Refused: against the policy.")
        else:
            forge.merge(pull)

    def check(self) -> None:
        stage = self.stage
        releases = stage.releases()
        recorders = {r.key: r for r in releases.values() if r.name.startswith("recorder-")}
        assert len(recorders) <= ROOM
        for release in releases.values():
            assert {cause.task for cause in release.causes} <= set(self.model), f"{release.key} is an orphan"
        for key, entry in self.model.items():
            self.check_task(key, entry, releases)
        self.check_initial(releases)

    def check_task(self, key: str, entry: Entry, releases: dict[str, Release]) -> None:
        status = self.stage.tasks.objects[key]["status"]
        conditions = {c["type"]: c for c in status["conditions"]}
        accepted, reason = conditions["Accepted"]["status"], conditions["Accepted"]["reason"]
        mine = [r for r in releases.values() if key in {cause.task for cause in r.causes}]
        assert reason in REASONS["Accepted"]
        if not entry.stands(self.stage.now_ns):
            assert (reason, mine) == ("LeaseExpired", [])
        elif accepted == "True" and conditions["Committed"]["status"] == "True":
            assert conditions["Ready"]["status"] == "True"
            assert sorted(r.key for r in mine) == status["releases"]
            assert f"cloud-0/recorder-{'-'.join(entry.pair)}" in status["releases"]
            assert not {"cloud-0", *entry.pair} & set(self.away)
        elif accepted == "True":
            assert conditions["Committed"]["reason"] == "ProposalRefused"
            assert (entry.refused_by_gate, mine) == (True, [])
        else:
            assert mine == []
            assert entry.in_trouble, f"{key} is refused without need: {conditions['Accepted']}"
            self.check_refusal(entry, reason, status)

    def check_refusal(self, entry: Entry, reason: str, status: dict[str, Any]) -> None:
        missing = {"cloud-0", *entry.pair} & set(self.away)
        allowed = {
            "Reject": SETTLED_REASONS,
            "Offload": SETTLED_REASONS,
            "Preempt": SETTLED_REASONS,
            "Postpone": {"Postponed", QUEUE_TOO_LONG, PREEMPTED},
        }[entry.policy]
        assert reason in allowed or (missing and reason == NO_CAPABLE_NODE), (reason, entry)
        assert ("queue" in status) == (reason == "Postponed")

    def check_initial(self, releases: dict[str, Release]) -> None:
        """Every vehicle that is there keeps its uplink, whatever tasks come and go."""
        if "cloud-0" not in self.away:
            for number in range(VEHICLES):
                name = f"vehicle-{number:02d}"
                assert (f"releases/{name}/mqtt-bridge.yaml" in releases) == (name not in self.away)


def causes(files: dict[str, str]) -> set[str]:
    """Tasks that a tree answers."""
    releases = read_tree({p: t for p, t in files.items() if p.startswith(("releases/", "sources/"))}).releases
    return {cause.task for release in releases.values() for cause in release.causes}


@contextmanager
def silent() -> Iterator[None]:
    """Without log lines: hundreds of histories write thousands."""
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(logging.NOTSET)


def run(folder: Path, examples: int, derandomize: bool) -> None:
    HistoryStage.template = template(folder)
    options = settings(
        max_examples=examples,
        stateful_step_count=12,
        derandomize=derandomize,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        database=None,
        phases=[Phase.explicit, Phase.generate],  # to shrink a history takes longer than to read it
    )
    with silent():
        run_state_machine_as_test(Histories, settings=options)  # type: ignore[no-untyped-call]


def test_random_histories(tmp_path: Path) -> None:
    run(tmp_path, EXAMPLES, derandomize=True)


@pytest.mark.thorough
def test_2000_random_histories(tmp_path: Path) -> None:
    run(tmp_path, 2000, derandomize=False)
