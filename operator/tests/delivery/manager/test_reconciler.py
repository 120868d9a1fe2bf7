"""The manager's loop over worlds in memory: what it proposes, reports and remembers, whatever happens in between."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.deployment.core.commit_messages import read_message
from robotkube.delivery.gate.core.verdict_comments import waiting_text
from robotkube.delivery.manager.loops.proposals.gate_decisions import VERDICT_SECONDS_MAX
from robotkube.delivery.manager.loops.proposals.plan_observer import ASK_SECONDS, OBSERVE_SECONDS_MAX
from robotkube.delivery.manager.loops.reconciler import (
    APPLICATIONS,
    ATTEMPTS_MAX,
    CATALOGUE,
    DEPLOYMENT,
    REPORT_AFTER_SECONDS,
    TASKS,
)
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.forge.core.resync import RESYNC_SECONDS, RESYNC_SECONDS_BUSY
from tests.stages.delivery.manager.manager_in_memory import MEETING, Stage


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


def test_a_changed_task_is_not_ready_before_its_plan_is_on_main(stage: Stage) -> None:
    """Its releases keep their names: those on main are there for what it asked before."""
    key = stage.ask(
        "near",
        application="uncertainty-operator",
        parameters={"site": "vehicle-01", "vehicle": "vehicle-00", "above": 0.5},
    )
    stage.settle()
    assert stage.tasks.condition(key, "Ready") == ("True", "Observed")
    stage.forge.decide = stage.forge.leave
    stage.tasks.change(key, parameters={"site": "vehicle-01", "vehicle": "vehicle-00", "above": 0.4})
    stage.go(3)
    assert stage.tasks.objects[key]["status"]["observedGeneration"] == 2
    assert stage.tasks.condition(key, "Committed") == ("False", "Proposed")
    assert stage.tasks.condition(key, "Ready") == ("", "")
    stage.forge.merge(stage.forge.pulls[max(stage.forge.pulls)])
    stage.go(wake=DEPLOYMENT)
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")
    assert stage.tasks.condition(key, "Ready") == ("False", "Progressing")


def test_a_status_is_about_the_generation_that_was_decided(stage: Stage) -> None:
    """A task that changes between decision and status is not answered by what was decided before."""
    key = stage.ask(
        "near",
        application="uncertainty-operator",
        parameters={"site": "vehicle-01", "vehicle": "vehicle-00", "above": 0.5},
    )
    stage.settle()
    stage.tasks.change(key, parameters={"site": "vehicle-01", "vehicle": "vehicle-00", "above": -1})
    stage.go(1, wake=APPLICATIONS)  # nobody told the manager of the task
    assert stage.tasks.objects[key]["status"]["observedGeneration"] == 1
    stage.go(3)
    assert stage.tasks.objects[key]["status"]["observedGeneration"] == 2
    assert stage.tasks.condition(key, "Accepted") == ("False", "InvalidParameters")


def test_a_quiet_world_costs_nothing(stage: Stage) -> None:
    stage.ask()
    stage.settle()
    pulls = len(stage.forge.pulls)
    patches = stage.tasks.patches
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


def test_the_forges_word_about_the_own_commit_saves_a_fetch_and_no_other_word_does(stage: Stage) -> None:
    stage.forge.decide = stage.forge.leave
    key = stage.ask()
    stage.go(1)
    proposed = stage.forge.pulls[2]
    stage.forge.merge(proposed)
    before = stage.repository.fetches
    stage.manager.wake(DEPLOYMENT, "f" * 40)
    stage.manager.wake(DEPLOYMENT, proposed.head)
    stage.manager.step()
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")
    assert stage.repository.fetches == before
    stage.manager.wake(DEPLOYMENT, "f" * 40)
    stage.manager.step()
    assert stage.repository.fetches == before + 1


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
        assert [report for report in stage.tasks.reports if report[0] == key] == [(key, "GateUnavailable", message)]
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


def test_statuses_say_when_the_forge_is_away_for_long(stage: Stage) -> None:
    stage.repository.away = True
    key = stage.ask()
    stage.manager.wake(TASKS)
    stage.fail()
    assert "status" not in stage.tasks.objects[key]
    stage.seconds += REPORT_AFTER_SECONDS + 1
    stage.fail()
    assert stage.tasks.condition(key, "Accepted") == ("True", "Accepted")
    assert stage.tasks.condition(key, "Committed") == ("False", "ForgeUnavailable")
    stage.manager = stage.start()
    unseen = stage.ask("unseen")
    stage.fail()
    assert stage.tasks.condition(unseen, "Accepted") == ("Unknown", "ForgeUnavailable")
    assert stage.tasks.condition(unseen, "Committed") == ("False", "ForgeUnavailable")
    assert [report[:2] for report in stage.tasks.reports] == [(key, "ForgeUnavailable"), (unseen, "ForgeUnavailable")]
    stage.repository.away = False
    stage.go(6)
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")


def test_a_pull_request_whose_number_was_not_returned_is_found(stage: Stage) -> None:
    stage.forge.gives_numbers = False
    stage.ask()
    stage.go()
    assert stage.tasks.objects[MEETING]["status"]["pullRequest"]["number"] == 2


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
    assert stage.manager.statistics.plans["unobserved"] == 1
    assert stage.tasks.condition(MEETING, "Ready") == ("False", "Progressing")


def test_ready_follows_the_health_of_its_releases(stage: Stage) -> None:
    stage.ask()
    stage.settle()
    stage.cluster.worsen("vehicle-00-mqtt-bridge", "Degraded")
    stage.go(wake=APPLICATIONS)
    assert stage.tasks.condition(MEETING, "Ready") == ("False", "Progressing")


def test_words_of_progress_are_written_once_in_a_second_and_the_last_ones_always(stage: Stage) -> None:
    stage.ask()
    stage.go()
    stage.cluster.settle(stage.releases())
    stage.go(20)
    name = "vehicle-00-mqtt-bridge"
    settled = stage.cluster.states[name]
    before = stage.tasks.patches
    for turn in range(20):
        stage.cluster.states[name] = replace(settled, health="Degraded", conditions=(f"turn {turn}",))
        stage.go(1, wake=APPLICATIONS)
    assert stage.tasks.condition(MEETING, "Ready") == ("False", "Progressing")
    assert 2 <= stage.tasks.patches - before <= 3
    assert 0 < stage.manager.step() <= 1.0
    stage.go(12, wake=APPLICATIONS)
    assert "turn 19" in stage.tasks.objects[MEETING]["status"]["conditions"][-1]["message"]
    stage.cluster.states[name] = settled
    stage.go(1, wake=APPLICATIONS)
    assert stage.tasks.condition(MEETING, "Ready") == ("True", "Observed")


def test_plans_are_observed_while_the_next_is_written(stage: Stage) -> None:
    stage.ask("a")
    stage.go()
    stage.ask("b", ("vehicle-01", "vehicle-02"))
    stage.go()
    assert [p["observed"] is None for p in stage.plans()] == [False, True, True]
    stage.cluster.settle(stage.releases())
    stage.go(wake=APPLICATIONS)
    assert all(p["observed"] for p in stage.plans())


def test_main_is_not_fetched_for_what_is_known_of_it(stage: Stage) -> None:
    stage.settle()
    fetches = stage.repository.fetches
    stage.manager.wake(DEPLOYMENT, stage.repository.tip)  # the forge reports what the gate has reported
    stage.manager.step()
    assert stage.repository.fetches == fetches
    stage.manager.wake(DEPLOYMENT, stage.repository.push({"README.md": "by hand\n"}))
    stage.manager.step()
    assert stage.repository.fetches == fetches + 1


def test_there_is_no_resync_while_plan_follows_plan(stage: Stage) -> None:
    stage.settle()
    fetches, began = stage.catalogue.fetches, stage.seconds
    while stage.seconds - began < 2 * RESYNC_SECONDS_BUSY:
        stage.ask() if "cloud-0/meeting" not in stage.tasks.objects else stage.tasks.delete("cloud-0/meeting")
        stage.go(steps=2, seconds=0.45)
    assert stage.catalogue.fetches == fetches + 2
    stage.go(steps=2, seconds=RESYNC_SECONDS)
    assert stage.catalogue.fetches > fetches + 2


def test_a_proposal_that_waits_is_polled_by_the_second_and_not_for_every_task(stage: Stage) -> None:
    stage.settle()
    stage.forge.decide = stage.forge.leave
    stage.ask()
    stage.go()
    fetches = stage.repository.fetches
    for _ in range(5):
        stage.go(steps=1, seconds=0.1, wake=TASKS)
    assert stage.repository.fetches <= fetches + 1
    stage.forge.merge(stage.forge.pulls[max(stage.forge.pulls)])
    stage.notified = [pull.state for pull in stage.forge.pulls.values()]  # no webhook comes
    stage.seconds += 1.0
    stage.manager.step()
    assert stage.tasks.condition("cloud-0/meeting", "Committed") == ("True", "Merged")
