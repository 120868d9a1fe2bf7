"""Three managers with namespaces of their own on one forge: every plan of each is merged, exactly once, and what two of
them answer together, by consent."""

import secrets
import threading
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from robotkube.delivery.deployment.core.commit_messages import read_message
from robotkube.delivery.deployment.core.policies.links import path_of
from robotkube.delivery.deployment.core.releases import read_release
from robotkube.delivery.gate.core.proposal_checks import Proposer
from robotkube.delivery.manager.core.placement.placement import Agent, NodeState
from robotkube.delivery.manager.core.placement.scopes import DeclaredManager, Operators, Scope
from robotkube.delivery.manager.loops.main_reader import MainReader
from robotkube.delivery.manager.loops.planner import ManagerSettings, Planner
from robotkube.delivery.manager.loops.proposals.plan_observer import PlanObserver
from robotkube.delivery.manager.loops.reconciler import DEPLOYMENT, TASKS, ApplicationManager
from robotkube.delivery.manager.ports.manager_ports import ManagerPorts
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.adapters.json_schema import validate
from robotkube.foundation.forge.adapters.git import GitClone, ProposalWriter
from robotkube.foundation.forge.adapters.hosts.gitea import GiteaForge
from robotkube.foundation.forge.adapters.push_hooks import ObjectsRelay
from robotkube.registry.catalogue.loops.verified_catalogue import AssuredCatalogue
from robotkube.setup.adapters.gitea_administration import GiteaAdministration
from robotkube.setup.loops.bootstrap import Bootstrap, ForgeAccount
from robotkube.testing.clusters import MemoryArgoCD, MemoryCluster, MemoryTasks
from robotkube.testing.leadership import MemoryLeadership
from tests.stages.forge.catalogue_evidence import trusted_keys
from tests.stages.forge.gitea import ForgeProcess
from tests.stages.forge.installation import (
    ACCOUNTS,
    CHARTS_URL,
    ApplicationSetController,
    Installation,
    forge_setup,
    objects_relay,
    start_gate,
)
from tests.stages.programs import free_port
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

MANAGERS = ("north", "south", "west")
PLAN_SECONDS_MAX = 180.0  # the last of 150 plans of three managers, on a machine that does other things
PLANS, PLANS_THOROUGH = 2, 50
MERGE_POLICY = "automatic:\n" + "".join(f"- {{author: {name}, paths: [releases/, sources/]}}\n" for name in MANAGERS)


@pytest.fixture(scope="module")
def managed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Installation]:
    """A forge of its own with an account for each manager."""
    process = ForgeProcess(tmp_path_factory.mktemp("managed-forge"))
    process.start()
    passwords = {name: secrets.token_hex(12) for name in (*ACCOUNTS, *MANAGERS)}
    port = free_port()
    setup = forge_setup(passwords, f"http://127.0.0.1:{port}/webhook")
    accounts = (*setup.accounts, *(ForgeAccount(name, passwords[name]) for name in MANAGERS))
    access = dict.fromkeys(MANAGERS, "read")
    repositories = tuple(
        replace(repository, access={**repository.access, **access}) for repository in setup.repositories
    )
    administration = GiteaAdministration(process.url, process.administrator, process.administrator_password)
    setup = replace(setup, accounts=accounts, repositories=repositories)
    Bootstrap(30, time.monotonic, time.sleep).forge(setup, administration)
    administration.disconnect()
    installed = Installation(process.url, passwords, port, tmp_path_factory.mktemp("managed"), setup)
    gate = installed.clone("gate")
    policy = gate.commit({"policies/merge.yaml": MERGE_POLICY}, "policy\n", [gate.tip()])
    assert gate.push(policy, "refs/heads/main") == ""
    yield installed
    installed.disconnect()
    process.remove()


@dataclass
class Running:
    """One manager in this process, with a cluster in memory; its agents are `cloud-<name>` and `vehicle-<name>`."""

    name: str
    manager: ApplicationManager
    tasks: MemoryTasks
    forge: GiteaForge
    relay: ObjectsRelay
    stopping: threading.Event = field(default_factory=threading.Event)
    thread: threading.Thread | None = None
    failure: str = ""

    @property
    def agents(self) -> tuple[str, str]:
        return f"cloud-{self.name}", f"vehicle-{self.name}"

    def start(self) -> None:
        self.thread = threading.Thread(target=self.manager.run, args=(self.stopping,), daemon=True)
        self.thread.start()

    def stop(self) -> None:
        self.manager.stop(self.stopping)
        if self.thread is not None:
            self.thread.join(10)
        self.forge.disconnect()
        self.relay.disconnect()

    def work(self, pairs: int) -> None:
        """So many tasks one after the other, each withdrawn when its plan is on main: two plans each."""
        cloud, vehicle = self.agents
        for number in range(pairs):
            key = f"{cloud}/task-{number}-of-{pairs}"  # a name of an earlier run would count as withdrawn at once
            self.ask(key, number, vehicle)
            until(lambda key=key: self.committed(key), f"{key} committed", PLAN_SECONDS_MAX)
            self.tasks.delete(key)
            self.manager.wake(TASKS)
            until(lambda key=key: self.withdrawn(key), f"{key} withdrawn", PLAN_SECONDS_MAX)

    def ask(self, key: str, number: int, *vehicles: str) -> None:
        """A task asks for a recording of these vehicles."""
        event = {"rule": "near", "id": f"e{number}", "trace": f"{number:032x}", "time": "2026-11-21T10:00:00Z"}
        spec = {"requester": self.name, "event": event, "application": "pose-point-cloud-recording"}
        namespace, _, task = key.partition("/")
        self.tasks.create(namespace, task, {**spec, "parameters": {"vehicles": list(vehicles)}})
        self.manager.wake(TASKS)

    def committed(self, key: str) -> bool:
        return self.tasks.condition(key, "Committed") == ("True", "Merged")

    def withdrawn(self, key: str) -> bool:
        plans = self.manager.records.as_json()["plans"]
        return any(plan["cause"] == "withdrawal" and plan["on_main"] and key in plan["tasks"] for plan in plans)


def make(installation: Installation, name: str, folder: Path) -> Running:
    """A manager that knows all agents and has its own two as scope."""
    url = installation.url
    account = (name, installation.passwords[name])
    deployment = GitClone(url, "robotkube/deployment", *account, folder / "deployment")
    relay = objects_relay(installation, name)
    proposals = ProposalWriter(folder / "deployment", *account, name, time.time, send_objects=relay.send)
    catalogue = AssuredCatalogue(GitClone(url, "robotkube/catalogue", *account, folder / "catalogue"), trusted_keys())
    roles = [(f"{role}-{one}", role) for one in MANAGERS for role in ("cloud", "vehicle")]
    nodes = [NodeState(agent, agent, role, frozenset({"recording"}), True) for agent, role in roles]
    scopes = {one: frozenset({f"cloud-{one}", f"vehicle-{one}"}) for one in MANAGERS}
    declared = tuple(DeclaredManager(one, Scope(agents, agents)) for one, agents in scopes.items())
    operators = Operators(Scope(scopes[name], scopes[name]), managers=declared)
    settings = ManagerSettings(tuple(Agent(a, role, a) for a, role in roles), CHARTS_URL, operators)
    tasks = MemoryTasks()
    cluster = MemoryCluster(nodes)
    main = MainReader(deployment)
    planner = Planner(settings, tasks, cluster, catalogue, main, Jinja2Templates().render, validate)
    observer = PlanObserver(cluster, MemoryArgoCD(), lambda call: call(), time.time_ns, time.monotonic)
    forge = GiteaForge(url, "robotkube/deployment", *account)
    ports = ManagerPorts(tasks, cluster, deployment, proposals, forge, MemoryLeadership(), name)
    manager = ApplicationManager(ports, catalogue, main, planner, observer, time.time_ns, time.monotonic)
    return Running(name, manager, tasks, forge, relay)


@pytest.fixture
def managers(managed: Installation, controller: ApplicationSetController, tmp_path: Path) -> Iterator[list[Running]]:
    proposers = tuple(Proposer(name, frozenset({f"cloud-{name}", f"vehicle-{name}"})) for name in MANAGERS)
    gate = start_gate(managed, controller.url, tmp_path / "gate", proposers=proposers)
    started = [make(managed, name, tmp_path / name) for name in MANAGERS]
    for one in started:
        one.start()
    yield started
    for one in started:
        one.stop()
    gate.stop()


@pytest.mark.parametrize("plans", [PLANS, pytest.param(PLANS_THOROUGH, marks=pytest.mark.thorough)])
def test_all_plans_of_three_managers_are_merged_exactly_once(
    managed: Installation, managers: list[Running], plans: int
) -> None:
    def work(one: Running) -> None:
        try:
            one.work(plans // 2)
        except AssertionError as error:
            one.failure = str(error)

    threads = [threading.Thread(target=work, args=(manager,)) for manager in managers]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [manager.failure for manager in managers] == [""] * len(managers)
    made = plans_on_main(managed)
    assert max(Counter(plan for plan, _, _ in made).values()) == 1
    for one in managers:
        mine = [(verb, tasks) for plan, name, (verb, tasks) in made if name == one.name and tasks]
        cloud = one.agents[0]
        wanted = [("deploy", (f"{cloud}/task-{n}-of-{plans // 2}",)) for n in range(plans // 2)]
        gone = [("withdraw", (f"{cloud}/task-{n}-of-{plans // 2}",)) for n in range(plans // 2)]
        assert mine[-plans:] == [step for pair in zip(wanted, gone, strict=True) for step in pair]
        assert one.manager.statistics.plans["refused"] == 0


TOPICS = [f"/vehicles/{{agent}}/{name}" for name in ("pose", "lidar_center/pointcloud", "lidar_center/transform")]
CONSENTS = {
    path_of("south"): f"sends: [{{to: north, topics: {TOPICS}}}]\n",
    path_of("north"): f"receives: [{{from: south, topics: {TOPICS}}}]\n",
}


def test_two_managers_answer_an_application_over_their_border_by_consent(
    managed: Installation, managers: list[Running]
) -> None:
    """Each plans for its own agents, and the gate merges both; without one of the consents nothing of it is left."""
    north, south, _ = managers
    key, cloud = "cloud-north/over-the-border", "/vehicles/vehicle_south/lidar_center/pointcloud"
    people = managed.clone("gate")

    def merged(files: dict[str, str | None]) -> None:
        assert people.push(people.commit(files, "policy(links)\n", [people.tip()]), "refs/heads/main") == ""

    def carried(agent: str, direction: str) -> bool:
        tree = people.repository[people.tip()].tree
        path = f"releases/{agent}/mqtt-bridge.yaml"
        values = read_release(tree[path].data.decode(), path).values if path in tree else {"bridge": {direction: []}}
        return cloud in {topic["name"] for topic in values["bridge"][direction]}

    def both(carry: bool) -> bool:
        for one in (north, south):
            one.manager.wake(DEPLOYMENT)
        return carried("cloud-north", "in") is carried("vehicle-south", "out") is carry

    north.ask(key, 1, "vehicle-north", "vehicle-south")
    until(lambda: north.tasks.condition(key, "Accepted") == ("False", "LinkNotConsented"), "refused")
    merged(dict(CONSENTS))
    until(lambda: both(True), "both ends are on main", PLAN_SECONDS_MAX)
    until(lambda: north.committed(key), "committed", PLAN_SECONDS_MAX)
    merged({path_of("south"): None})
    until(lambda: both(False), "neither end is on main", PLAN_SECONDS_MAX)
    assert north.tasks.condition(key, "Accepted") == ("False", "LinkNotConsented")
    assert [manager.manager.statistics.plans["refused"] for manager in managers] == [0, 0, 0]


def plans_on_main(installation: Installation) -> list[tuple[str, str, tuple[str, tuple[str, ...]]]]:
    """Id, manager, verb and tasks of every plan on main, oldest first."""
    clone = installation.clone("argocd")
    at = clone.repository[clone.tip()]
    plans = []
    while at is not None:
        if "\nRobotKube-Plan: " in at.message:
            message = read_message(at.message)
            tasks = tuple(cause.task for cause in message.causes)
            plans.append((message.plan, message.manager, (message.verb, tasks)))
        at = at.parents[0] if at.parents else None
    return plans[::-1]
