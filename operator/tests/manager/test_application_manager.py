"""The manager's loop over worlds in memory: what it proposes, says and remembers, whatever happens in between."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from signed_evidence import PLATFORM, POLICY_TEXT, Signing, signing_key, trusting

from robotkube.adapters.schemas_jsonschema import validate
from robotkube.adapters.templates_jinja2 import Jinja2Templates
from robotkube.domain.catalogue import read_catalogue
from robotkube.domain.charts_packing import sha256
from robotkube.domain.errors import InputError, RefusalError, UnavailableError
from robotkube.domain.evidence import Artefact
from robotkube.domain.placement import Agent, NodeState
from robotkube.domain.proposals import read_message
from robotkube.domain.releases import Release, read_tree
from robotkube.domain.verdict_texts import refusal_text, waiting_text
from robotkube.services.application_manager import (
    APPLICATIONS,
    ATTEMPTS_MAX,
    CATALOGUE,
    DEPLOYMENT,
    SAID_SECONDS,
    TASKS,
    ApplicationManager,
    World,
)
from robotkube.services.assured_catalogue import AssuredCatalogue
from robotkube.services.manager_decisions import VERDICT_SECONDS_MAX
from robotkube.services.manager_observing import ASK_SECONDS, OBSERVE_SECONDS_MAX, PlanObserver
from robotkube.services.manager_planning import ManagerSettings, Planner
from robotkube.services.manager_reading import MainReader
from robotkube.testing.clusters import MemoryArgoCD, MemoryCluster, MemoryTasks
from robotkube.testing.forges import MemoryForge, MemoryRepository

REGISTRY = Path(__file__).parents[3] / "registry"
CHARTS = "oci://forge.robotkube.svc.cluster.local:3000/verified"
MEETING = "cloud-0/meeting"
START_NS = 1795250000_000000000


def catalogue_files(signing: Signing) -> dict[str, str]:
    """The project's own catalogue, published with evidence."""
    files = {str(p.relative_to(REGISTRY)): p.read_text() for p in REGISTRY.glob("applications/*.yaml")}
    for index, path in enumerate(sorted(REGISTRY.glob("charts/*/*.yaml"))):
        document = yaml.safe_load(path.read_text())
        about = Artefact(path.parent.name, document["spec"]["version"], f"sha256:{index:064x}", PLATFORM)
        envelopes = signing.sign(about)
        files |= {f"{about.folder}/{name}.json": data.decode() for name, data in envelopes.items()}
        evidence = sha256(envelopes["summary"])
        status = {"state": "verified", "digest": about.digest, "images": [], "evidence": evidence}
        document["status"] = {**status, "policy": signing.policy.digest}
        files[str(path.relative_to(REGISTRY))] = yaml.safe_dump(document)
    return {**files, "policies/release.yaml": "assurance: verified\n", "policies/verification.yaml": POLICY_TEXT}


class Stage:
    """Everything around one manager; the clock moves only when a test moves it."""

    def __init__(self, folder: Path, vehicles: int = 3) -> None:
        key = signing_key(folder / "key")
        self.verifier = trusting(folder / "trusted", key)
        names = [(f"vehicle-{i:02d}", "vehicle") for i in range(vehicles)] + [("cloud-0", "cloud")]
        self.settings = ManagerSettings(tuple(Agent(name, role, name) for name, role in names), CHARTS)
        capabilities = {"cloud": frozenset({"recording"})}
        self.cluster = MemoryCluster(
            [NodeState(name, name, role, capabilities.get(role, frozenset()), True) for name, role in names]
        )
        self.repository, self.catalogue = MemoryRepository(), MemoryRepository()
        self.repository.push({"policies/initial.yaml": "add: []\nremove: []\n"}, "seed")
        self.catalogue.push(catalogue_files(Signing(key)), "seed")
        self.forge = MemoryForge(self.repository)
        self.tasks, self.argocd = MemoryTasks(), MemoryArgoCD()
        self.seconds = 0.0
        self.manager = self.start()

    def start(self) -> ApplicationManager:
        """A new process: nothing is remembered."""

        def now_ns() -> int:
            return START_NS + int(self.seconds * 1e9)

        def monotonic() -> float:
            return self.seconds

        def aside(call: Callable[[], None]) -> None:
            call()

        catalogue, main = AssuredCatalogue(self.catalogue, self.verifier), MainReader(self.repository)
        render = Jinja2Templates().render
        planner = Planner(self.settings, self.tasks, self.cluster, catalogue, main, render, validate)
        observer = PlanObserver(self.cluster, self.argocd, aside, now_ns, monotonic)
        world = World(self.tasks, self.cluster, self.repository, self.forge, self.forge)
        return ApplicationManager(world, catalogue, main, planner, observer, now_ns, monotonic)

    def go(self, steps: int = 4, seconds: float = 0.1, wake: str = TASKS) -> None:
        self.manager.wake(wake)
        for _ in range(steps):
            self.manager.step()
            self.seconds += seconds

    def fail(self) -> None:
        """One turn of the loop in which the world does not answer."""
        stopping = threading.Event()
        threading.Timer(0.2, stopping.set).start()
        self.manager.wake(TASKS)
        self.manager.run(stopping)

    def settle(self) -> None:
        """Propose, merge, let Argo CD finish, observe."""
        self.go()
        self.cluster.settle(self.releases())
        self.go(wake=APPLICATIONS)

    def releases(self) -> dict[str, Release]:
        tree = read_tree(self.repository.files(self.repository.tip, ("releases", "sources")))
        assert tree.problems == ()
        return dict(tree.releases)

    def ask(self, name: str = "meeting", vehicles: tuple[str, ...] = ("vehicle-00", "vehicle-01"), **spec: Any) -> str:
        event = {"rule": "lidar-proximity", "id": f"event-{name}", "trace": "a" * 32, "time": "2026-11-21T10:00:00Z"}
        document = {
            "requester": "cloud-0/event-detector",
            "event": event,
            "reason": f"{', '.join(vehicles)} within 400 m",
            "application": "pose-point-cloud-recording",
            "parameters": {"vehicles": list(vehicles)},
            **spec,
        }
        self.tasks.create("cloud-0", name, document)
        return f"cloud-0/{name}"

    def plans(self) -> list[dict[str, Any]]:
        return list(self.manager.records.as_json()["plans"])


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    """After the initial configuration is observed."""
    found = Stage(tmp_path)
    found.settle()
    return found


def test_the_initial_configuration_is_proposed_merged_and_observed(stage: Stage) -> None:
    [plan] = stage.plans()
    assert plan["cause"] == "initial"
    assert plan["tasks"] == []
    assert plan["pull_request"] == 1
    assert plan["started"] <= plan["proposed"] <= plan["merged"] <= plan["synced"] <= plan["observed"]
    assert len(plan["created"]) == 5
    assert stage.manager.reasons_not_ready() == []
    message = read_message(stage.repository.commits[stage.repository.tip].message)
    assert (message.initial, message.plan) == (True, plan["plan"])
    assert "## Decided" in stage.forge.bodies[1]


def test_a_task_goes_all_the_way_and_back(stage: Stage) -> None:
    before = stage.releases()
    key = stage.ask()
    stage.go()
    assert stage.tasks.condition(key, "Accepted") == ("True", "Accepted")
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")
    assert stage.tasks.condition(key, "Synced") == ("False", "Progressing")
    stage.cluster.settle(stage.releases())
    stage.go(wake=APPLICATIONS)
    assert stage.tasks.condition(key, "Ready") == ("True", "Observed")
    status = stage.tasks.objects[key]["status"]
    plan = stage.plans()[-1]
    assert status["plan"] == plan["plan"]
    assert status["commit"] == stage.repository.tip == plan["commit"]
    assert status["pullRequest"] == {"number": 2, "url": "http://forge/pulls/2"}
    assert status["releases"] == [
        "cloud-0/mqtt-bridge",
        "cloud-0/recorder-vehicle-00-vehicle-01",
        "vehicle-00/mqtt-bridge",
        "vehicle-01/mqtt-bridge",
    ]
    stage.tasks.delete(key)
    stage.settle()
    last = stage.plans()[-1]
    assert (last["cause"], last["tasks"]) == ("withdrawal", [key])
    assert last["observed"] is not None
    after = stage.releases()
    assert {p: r.values for p, r in after.items()} == {p: r.values for p, r in before.items()}
    assert len(stage.plans()) == 3


def test_a_quiet_world_costs_nothing(stage: Stage) -> None:
    stage.ask()
    stage.settle()
    pulls, patches = len(stage.forge.pulls), stage.tasks.patches
    stage.go(50, seconds=1.0)
    assert (len(stage.forge.pulls), stage.tasks.patches) == (pulls, patches)
    assert stage.argocd.hooks == []


def test_tasks_that_come_while_one_is_decided_are_answered_together(stage: Stage) -> None:
    stage.forge.decide = stage.forge.leave
    first = stage.ask("a")
    stage.go(1)
    assert stage.tasks.condition(first, "Committed") == ("False", "Proposed")
    second, third = stage.ask("b", ("vehicle-01", "vehicle-02")), stage.ask("c", ("vehicle-00", "vehicle-02"))
    stage.go(3)
    assert len(stage.forge.pulls) == 2
    stage.forge.decide = stage.forge.merge
    stage.forge.merge(stage.forge.pulls[2])
    stage.go(3)
    assert len(stage.forge.pulls) == 3
    assert stage.plans()[-1]["tasks"] == [second, third]
    assert stage.tasks.condition(third, "Committed") == ("True", "Merged")


def test_main_moving_makes_the_plan_anew(stage: Stage) -> None:
    stage.forge.decide = stage.forge.leave
    stage.ask()
    stage.go(1)
    stage.repository.push({"README.md": "by a person"})
    stage.forge.decide = stage.forge.merge
    stage.go(4, wake=DEPLOYMENT)
    assert stage.tasks.condition(MEETING, "Committed") == ("True", "Merged")
    assert stage.manager.statistics.plans["outdated"] == 1
    assert stage.plans()[1]["error"] == "main moved before the gate decided; built again"


def test_rebuilding_has_a_bound(stage: Stage) -> None:
    def overtake(pull: Any) -> None:
        stage.repository.push({"README.md": str(pull.number)})

    stage.forge.decide = overtake
    stage.ask()
    stage.go(30, seconds=0.01)
    assert stage.manager.statistics.plans["outdated"] == ATTEMPTS_MAX
    stage.seconds += 60
    stage.forge.decide = stage.forge.merge
    stage.go(4)
    assert stage.tasks.condition(MEETING, "Committed") == ("True", "Merged")


def test_a_refused_plan_is_said_and_not_repeated_until_its_inputs_change(stage: Stage) -> None:
    stage.forge.decide = lambda pull: stage.forge.refuse(pull, "the chart is not in the catalogue")
    stage.ask()
    stage.go(20)
    assert len(stage.forge.pulls) == 2
    assert stage.tasks.condition(MEETING, "Committed") == ("False", "ProposalRefused")
    committed = stage.tasks.objects[MEETING]["status"]["conditions"][1]
    assert committed["message"] == "the chart is not in the catalogue"
    stage.forge.decide = stage.forge.merge
    stage.go(20)
    assert len(stage.forge.pulls) == 2
    stage.tasks.objects[MEETING]["metadata"]["generation"] = 2
    stage.go(4)
    assert stage.tasks.condition(MEETING, "Committed") == ("True", "Merged")


def test_one_refused_task_does_not_hold_the_others(stage: Stage) -> None:
    def judge(pull: Any) -> None:
        bad = "vehicle-02" in stage.repository.trees[pull.head].get(
            "releases/cloud-0/recorder-vehicle-00-vehicle-02.yaml", ""
        )
        stage.forge.refuse(pull, "no") if bad else stage.forge.merge(pull)

    stage.forge.decide = judge
    bad = stage.ask("bad", ("vehicle-00", "vehicle-02"))
    good = stage.ask("good", ("vehicle-00", "vehicle-01"))
    stage.go(12)
    assert stage.tasks.condition(good, "Committed") == ("True", "Merged")
    assert stage.tasks.condition(bad, "Committed") == ("False", "ProposalRefused")
    pulls = len(stage.forge.pulls)
    stage.go(20)
    assert len(stage.forge.pulls) == pulls


def test_a_refused_withdrawal_is_not_repeated(stage: Stage) -> None:
    stage.ask()
    stage.settle()
    stage.forge.decide = lambda pull: stage.forge.refuse(pull, "no")
    stage.tasks.delete(MEETING)
    stage.go(20)
    assert len(stage.forge.pulls) == 3


def test_a_task_waits_for_a_gate_that_is_down_and_goes_on_when_it_is_back(stage: Stage) -> None:
    stage.forge.decide = stage.forge.leave
    first = stage.ask()
    stage.go(2)
    assert stage.tasks.condition(first, "Committed") == ("False", "Proposed")
    stage.go(3, seconds=VERDICT_SECONDS_MAX)
    later = stage.ask("later", ("vehicle-01", "vehicle-02"))
    stage.go(50, seconds=60.0)
    for key in (first, later):
        assert stage.tasks.condition(key, "Committed") == ("False", "GateUnavailable")
        message = stage.tasks.objects[key]["status"]["conditions"][1]["message"]
        assert message.startswith("no verdict of the gate about pull request 2 within 15 s; it waits")
        assert [told for told in stage.tasks.told if told[0] == key] == [(key, "GateUnavailable", message)]
    assert len(stage.forge.pulls) == 2
    stage.forge.decide = stage.forge.merge
    stage.forge.merge(stage.forge.pulls[2])
    stage.go(6)
    assert [stage.tasks.condition(key, "Committed") for key in (first, later)] == [("True", "Merged")] * 2
    assert len(stage.forge.pulls) == 3
    log = stage.repository.log(None, 100)
    assert len({read_message(commit.message).plan for commit in log[1:]}) == len(log) - 1 == 3


def test_a_plan_that_waits_for_a_persons_approval_says_so(stage: Stage) -> None:
    stage.forge.decide = lambda pull: stage.forge.comment(pull.number, waiting_text(pull.head, "approval"))
    key = stage.ask()
    stage.go(4, seconds=VERDICT_SECONDS_MAX)
    assert stage.tasks.condition(key, "Committed") == ("False", "WaitsForApproval")
    assert "when another person" in stage.tasks.objects[key]["status"]["conditions"][1]["message"]
    stage.forge.merge(stage.forge.pulls[2])
    stage.go(4)
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")


def test_what_the_gate_refuses_is_in_the_status_and_told_once(stage: Stage) -> None:
    text = refusal_text("c" * 40, ["releases/cloud-0/x.yaml: no"])
    stage.forge.decide = lambda pull: stage.forge.refuse(pull, text)
    key = stage.ask()
    stage.go(20)
    assert stage.tasks.told == [(key, "ProposalRefused", text.strip())]
    stage.manager = stage.start()
    stage.go(20)
    assert stage.tasks.told == [(key, "ProposalRefused", text.strip())]


def test_an_event_that_is_refused_holds_nothing(stage: Stage) -> None:
    def refuse(task: Any, reason: str, text: str) -> None:
        raise InputError("events are forbidden")

    stage.tasks.tell = refuse  # type: ignore[method-assign]
    stage.forge.decide = lambda pull: stage.forge.refuse(pull, "no")
    key = stage.ask()
    stage.go(8)
    assert stage.tasks.condition(key, "Committed") == ("False", "ProposalRefused")


def test_a_proposal_that_the_forge_itself_refuses_is_said(stage: Stage) -> None:
    def refuse(commit: str, topic: str, title: str, body: str) -> int | None:
        raise RefusalError("ProposalRefused", "the forge refused proposal: you may not")

    stage.forge.propose = refuse  # type: ignore[method-assign]
    key = stage.ask()
    stage.go(8)
    assert stage.tasks.condition(key, "Committed") == ("False", "ProposalRefused")
    assert stage.tasks.told == [(key, "ProposalRefused", "the forge refused proposal: you may not")]


# -- evidence ---------------------------------------------------------------------------------------------------------


def edit(stage: Stage, path: str, **status: Any) -> None:
    """What somebody who may write the catalogue repository does by hand."""
    document = yaml.safe_load(stage.catalogue.trees[stage.catalogue.tip][path])
    document["status"] |= status
    stage.catalogue.push({path: yaml.safe_dump(document)})


DETECTOR = "charts/event-detector/0.1.0.yaml"


def test_every_commit_names_the_evidence_of_its_charts(stage: Stage) -> None:
    key = stage.ask()
    stage.go()
    message = read_message(stage.repository.commits[stage.repository.tip].message)
    catalogue = read_catalogue(stage.catalogue.trees[stage.catalogue.tip])
    assert [chart.name for chart in message.charts] == ["event-detector", "mqtt-bridge"]
    assert list(message.evidence) == [catalogue.charts[chart.name][0].evidence for chart in message.charts]
    release = stage.releases()["releases/cloud-0/recorder-vehicle-00-vehicle-01.yaml"]
    assert release.evidence == message.evidence[0]
    assert release.causes[0].parameters == '{"vehicles":["vehicle-00","vehicle-01"]}'
    body = stage.forge.bodies[2]
    assert "Assurance of the release policy: **verified**." in body
    assert "- event-detector 0.1.0: passed static, images, install under policy" in body
    assert f"summary `{message.evidence[0]}`" in body
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")


def test_an_entry_edited_to_verified_without_evidence_is_no_verified_version(stage: Stage) -> None:
    files = stage.catalogue.trees[stage.catalogue.tip]
    stage.catalogue.push({path: None for path in files if path.startswith("evidence/event-detector/")})
    edit(stage, DETECTOR, digest="sha256:" + "f" * 64)
    key = stage.ask()
    stage.go(wake=CATALOGUE)
    assert stage.tasks.condition(key, "Accepted") == ("False", "NoVerifiedVersion")
    message = stage.tasks.objects[key]["status"]["conditions"][0]["message"]
    assert "event-detector 0.1.0 (verified): no valid evidence: suite static: there is no evidence" in message
    assert stage.tasks.told == [(key, "NoVerifiedVersion", message)]


def test_what_runs_stays_when_its_evidence_is_in_doubt(stage: Stage) -> None:
    key = stage.ask()
    stage.settle()
    before = stage.releases()
    files = stage.catalogue.trees[stage.catalogue.tip]
    stage.catalogue.push({path: None for path in files if path.startswith("evidence/")})
    stage.go(20, wake=CATALOGUE)
    assert stage.tasks.condition(key, "Accepted") == ("False", "NoVerifiedVersion")
    assert stage.releases() == before
    stage.tasks.delete(key)
    stage.go(20)
    assert "releases/cloud-0/recorder-vehicle-00-vehicle-01.yaml" not in stage.releases()


def test_without_assurance_the_evidence_is_none(stage: Stage) -> None:
    stage.catalogue.push({"policies/release.yaml": "assurance: none\n"})
    stage.ask()
    stage.go(wake=CATALOGUE)
    message = read_message(stage.repository.commits[stage.repository.tip].message)
    assert set(message.evidence) == {"none"}
    assert {release.evidence for release in stage.releases().values()} == {"none"}
    assert "- event-detector 0.1.0: none" in stage.forge.bodies[2]


@pytest.mark.parametrize("moment", ["before the decision", "after the merge", "after all"])
def test_a_restart_loses_nothing(stage: Stage, moment: str) -> None:
    stage.forge.decide = stage.forge.leave
    stage.ask()
    stage.go(1)
    if moment == "before the decision":
        stage.manager = stage.start()
        stage.forge.decide = stage.forge.merge
    stage.forge.merge(stage.forge.pulls[2])
    stage.forge.decide = stage.forge.merge
    if moment == "after all":
        stage.go()
        stage.cluster.settle(stage.releases())
        stage.tasks.objects[MEETING].pop("status")
    if moment != "before the decision":
        stage.manager = stage.start()
    stage.settle()
    status = stage.tasks.objects[MEETING]["status"]
    assert stage.tasks.condition(MEETING, "Ready") == ("True", "Observed")
    assert status["pullRequest"]["number"] == 2
    assert status["commit"] == stage.repository.tip
    stage.manager = stage.start()
    stage.tasks.delete(MEETING)
    stage.settle()
    message = read_message(stage.repository.commits[stage.repository.tip].message)
    assert [c.task for c in message.causes] == [MEETING]
    assert message.verb == "withdraw"
    assert len(stage.releases()) == 5


def test_the_forge_may_be_away(stage: Stage) -> None:
    stage.ask()
    stage.repository.away = True
    with pytest.raises(UnavailableError):
        stage.go()
    stage.repository.away = False
    stage.go(6)
    assert stage.tasks.condition(MEETING, "Committed") == ("True", "Merged")


def test_tasks_are_told_when_the_forge_is_away_for_long(stage: Stage) -> None:
    stage.repository.away = True
    key = stage.ask()
    stage.manager.wake(TASKS)
    stage.fail()
    assert "status" not in stage.tasks.objects[key]
    stage.seconds += SAID_SECONDS + 1
    stage.fail()
    assert stage.tasks.condition(key, "Accepted") == ("True", "Accepted")
    assert stage.tasks.condition(key, "Committed") == ("False", "ForgeUnavailable")
    stage.manager = stage.start()
    unseen = stage.ask("unseen")
    stage.fail()
    assert stage.tasks.condition(unseen, "Accepted") == ("Unknown", "ForgeUnavailable")
    assert stage.tasks.condition(unseen, "Committed") == ("False", "ForgeUnavailable")
    assert [told[:2] for told in stage.tasks.told] == [(key, "ForgeUnavailable"), (unseen, "ForgeUnavailable")]
    stage.repository.away = False
    stage.go(6)
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")


def test_a_pull_request_whose_number_was_not_told_is_found(stage: Stage) -> None:
    stage.forge.tell_numbers = False
    stage.ask()
    stage.go()
    assert stage.tasks.objects[MEETING]["status"]["pullRequest"]["number"] == 2


@pytest.mark.parametrize(
    ("spec", "reason", "text"),
    [
        ({"application": "nothing"}, "UnknownApplication", "the catalogue has no application 'nothing'"),
        ({"parameters": {"vehicles": []}}, "InvalidParameters", "parameters.vehicles"),
        ({"event": {"rule": "a b", "id": "1", "trace": "t"}}, "InvalidParameters", "spec.event.rule"),
        ({"parameters": {"vehicles": ["vehicle-44"]}}, "NoCapableNode", "vehicle-44"),
        ({"surprise": 1}, "InvalidParameters", "spec.surprise: unknown key"),
    ],
)
def test_refused_tasks_are_told_why(stage: Stage, spec: dict[str, Any], reason: str, text: str) -> None:
    key = stage.ask(**spec)
    stage.go()
    assert stage.tasks.condition(key, "Accepted") == ("False", reason)
    assert text in stage.tasks.objects[key]["status"]["conditions"][0]["message"]
    assert len(stage.forge.pulls) == 1


def test_a_refused_task_is_accepted_when_the_world_changes(stage: Stage) -> None:
    cloud = stage.cluster.machines.pop()
    key = stage.ask()
    stage.go()
    assert stage.tasks.condition(key, "Accepted") == ("False", "NoCapableNode")
    stage.cluster.machines.append(cloud)
    stage.go()
    assert stage.tasks.condition(key, "Accepted") == ("True", "Accepted")


def test_a_broken_catalogue_or_policy_never_withdraws(stage: Stage) -> None:
    stage.catalogue.push({"applications/pose-telemetry.yaml": "kind: ["})
    stage.repository.push({"policies/initial.yaml": "add: 3\n"})
    stage.go(wake=CATALOGUE)
    stage.go(wake=DEPLOYMENT)
    assert len(stage.forge.pulls) == 1
    stage.manager = stage.start()
    with pytest.raises(InputError, match="nothing is planned until it is repaired"):
        stage.go()
    assert len(stage.forge.pulls) == 1


def test_a_task_that_was_made_anew_under_its_old_name_gets_its_own_status_and_chance(stage: Stage) -> None:
    stage.forge.decide = lambda pull: stage.forge.refuse(pull, "no")
    key = stage.ask()
    stage.go(6)
    assert stage.tasks.condition(key, "Committed") == ("False", "ProposalRefused")
    stage.forge.decide = stage.forge.merge
    stage.tasks.delete(key)
    stage.ask()
    stage.tasks.objects[key]["metadata"]["uid"] = "another"
    stage.go(6)
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")


def test_a_status_that_is_refused_does_not_hold_the_others(stage: Stage) -> None:
    def refuse(namespace: str, name: str, status: Any) -> bool:
        if name == "bad":
            raise InputError("status.plan: too long")
        return MemoryTasks.patch_status(stage.tasks, namespace, name, status)

    stage.tasks.patch_status = refuse  # type: ignore[method-assign]
    stage.ask("bad", ("vehicle-00", "vehicle-02"))
    good = stage.ask("good")
    stage.settle()
    assert stage.tasks.condition(good, "Ready") == ("True", "Observed")


def test_people_change_the_initial_configuration(stage: Stage) -> None:
    text = "add:\n- {application: bag-player, forRole: vehicle, parameters: {claim: run}}\nremove: []\n"
    stage.repository.push({"policies/initial.yaml": text})
    stage.go(wake=DEPLOYMENT)
    assert len(stage.releases()) == 8
    assert stage.plans()[-1]["cause"] == "initial"


def test_a_new_agent_gets_its_initial_configuration(tmp_path: Path) -> None:
    stage = Stage(tmp_path)
    node = stage.cluster.machines.pop(0)
    stage.settle()
    assert "releases/vehicle-00/mqtt-bridge.yaml" not in stage.releases()
    stage.cluster.machines.append(node)
    stage.settle()
    assert "releases/vehicle-00/mqtt-bridge.yaml" in stage.releases()
    assert stage.plans()[-1]["created"] == ["vehicle-00/mqtt-bridge"]


def test_argo_cd_is_asked_again_until_it_knows_the_plan(stage: Stage) -> None:
    stage.ask()
    stage.go(4, seconds=0.1)
    assert stage.argocd.hooks == []
    stage.go(10, seconds=ASK_SECONDS / 2, wake=APPLICATIONS)
    assert 3 <= len(stage.argocd.hooks) <= 5
    assert "vehicle-00-mqtt-bridge" in stage.argocd.refreshes
    stage.cluster.settle(stage.releases())
    stage.go(wake=APPLICATIONS)
    asked = len(stage.argocd.hooks)
    stage.go(20, seconds=1.0)
    assert len(stage.argocd.hooks) == asked


def test_argo_cd_is_asked_to_compare_again_when_it_could_not(stage: Stage) -> None:
    """As after an installation on a forge that starts later: all are known, none could be compared, in turns all are
    asked for; the hook would not help. A manager that starts finds the plan on main."""
    stage.cluster.states = {
        name: replace(state, sync="Unknown", conditions=("connection refused",))
        for name, state in stage.cluster.states.items()
    }
    stage.manager = stage.start()
    stage.go(6, seconds=ASK_SECONDS)
    assert set(stage.argocd.refreshes) == set(stage.cluster.states)
    assert stage.argocd.hooks == []
    stage.cluster.settle(stage.releases())
    stage.go(wake=APPLICATIONS)
    asked = len(stage.argocd.refreshes)
    stage.go(20, seconds=1.0)
    assert len(stage.argocd.refreshes) == asked


def test_a_plan_that_is_never_observed_is_given_up(stage: Stage) -> None:
    stage.ask()
    stage.go()
    stage.go(2, seconds=OBSERVE_SECONDS_MAX)
    stage.go()
    assert "not observed within" in str(stage.plans()[-1]["error"])
    assert stage.tasks.condition(MEETING, "Ready") == ("False", "Progressing")


def test_ready_follows_the_health_of_its_releases(stage: Stage) -> None:
    stage.ask()
    stage.settle()
    stage.cluster.worsen("vehicle-00-mqtt-bridge", "Degraded")
    stage.go(wake=APPLICATIONS)
    assert stage.tasks.condition(MEETING, "Ready") == ("False", "Progressing")


def test_plans_are_observed_while_the_next_is_written(stage: Stage) -> None:
    stage.ask("a")
    stage.go()
    stage.ask("b", ("vehicle-01", "vehicle-02"))
    stage.go()
    assert [p["observed"] is None for p in stage.plans()] == [False, True, True]
    stage.cluster.settle(stage.releases())
    stage.go(wake=APPLICATIONS)
    assert all(p["observed"] for p in stage.plans())
