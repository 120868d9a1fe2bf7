"""What the manager does with Git when others write it too: broken files, edits, changes of mind, other leaders."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.deployment.core.commit_messages import (
    REPAIR,
    REVERT,
    CommitMessage,
    read_message,
    write_message,
)
from robotkube.delivery.deployment.core.plan_notes import read_note
from robotkube.delivery.deployment.core.policies.edits import PATH as EDITS_PATH
from robotkube.delivery.deployment.core.releases import write_release
from robotkube.delivery.manager.core.plans import Plan
from robotkube.delivery.manager.loops.reconciler import ATTEMPTS_MAX, DEPLOYMENT, MAIN_SECONDS
from robotkube.foundation.forge.core.resync import QUIET_SECONDS, RESYNC_SECONDS
from tests.stages.delivery.manager.manager_in_memory import MEETING, Stage

BRIDGE = "releases/vehicle-00/mqtt-bridge.yaml"


def last_message(stage: Stage) -> CommitMessage:
    return read_message(stage.repository.commits[stage.repository.tip].message)


def condition_text(stage: Stage, key: str, kind: str) -> str:
    return next(c["message"] for c in stage.tasks.objects[key]["status"]["conditions"] if c["type"] == kind)


# -- a broken main --


def duplicate(stage: Stage) -> dict[str, str | None]:
    """A release whose Argo CD Application has the name of another one."""
    release = next(r for p, r in stage.releases().items() if p == BRIDGE)
    named = replace(release, namespace="vehicle", name="00-mqtt-bridge")
    source = next(p for p in stage.repository.trees[stage.repository.tip] if p.startswith("sources/vehicle-00/mqtt"))
    text = stage.repository.trees[stage.repository.tip][source].replace("namespace: vehicle-00", "namespace: vehicle")
    return {named.path: write_release(named), source.replace("vehicle-00", "vehicle"): text}


BREAKS: dict[str, Any] = {
    "malformed": lambda stage: {BRIDGE: "apiVersion: ["},
    "empty": lambda stage: {BRIDGE: ""},
    "a new one that is empty": lambda stage: {"releases/vehicle-00/junk.yaml": ""},
    "at another depth": lambda stage: {"releases/junk.yaml": "a: 1\n"},
    "a duplicate name": duplicate,
    "its source is gone": lambda stage: {
        path: None for path in stage.repository.trees[stage.repository.tip] if path.startswith("sources/vehicle-00/")
    },
}


@pytest.mark.parametrize("case", BREAKS)
def test_a_broken_main_is_named_and_repaired_and_then_everything_goes_on(stage: Stage, case: str) -> None:
    before = dict(stage.repository.trees[stage.repository.tip])
    stage.forge.decide = stage.forge.leave
    broken = stage.repository.push(BREAKS[case](stage), "by a person")
    key = stage.ask()
    stage.go(1, wake=DEPLOYMENT)
    assert stage.tasks.condition(key, "Committed") == ("False", "MainBroken")
    assert f"main is broken since commit {broken[:12]}" in condition_text(stage, key, "Committed") or "sources" in str(
        stage.repository.commits[broken].changes
    )
    assert stage.manager.statistics.broken_files > 0
    number = max(stage.forge.pulls)
    stage.forge.merge(stage.forge.pulls[number])
    message = last_message(stage)
    assert message.kinds == (REPAIR,)
    if case != "its source is gone":
        assert message.reverts == (broken,)
    repaired = dict(stage.repository.trees[stage.repository.tip])
    if case == "a duplicate name":
        repaired = {path: text for path, text in repaired.items() if not path.startswith("sources/vehicle/")}
    assert repaired == before
    assert "## Repaired" in stage.forge.bodies[number]
    stage.forge.decide = stage.forge.merge
    stage.go(6)
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")
    assert stage.manager.statistics.broken_files == 0


def test_a_broken_main_is_seen_without_any_delivery_of_the_forge(stage: Stage) -> None:
    stage.repository.push({BRIDGE: ""})
    assert 2 * MAIN_SECONDS <= RESYNC_SECONDS
    stage.seconds += MAIN_SECONDS
    stage.manager.step()
    assert stage.plans()[-1]["cause"] == REPAIR


def test_a_repair_that_is_refused_is_not_repeated(stage: Stage) -> None:
    stage.forge.decide = lambda pull: stage.forge.refuse(pull, "Refused: no")
    stage.repository.push({BRIDGE: ""})
    stage.go(20, seconds=1.0, wake=DEPLOYMENT)
    assert len(stage.forge.pulls) == 2
    stage.forge.decide = stage.forge.merge
    stage.repository.push({"README.md": "another commit"})
    stage.go(6, wake=DEPLOYMENT)
    assert last_message(stage).kinds == (REPAIR,)


# -- people's edits --


def edit(stage: Stage) -> str:
    text = stage.repository.trees[stage.repository.tip][BRIDGE]
    assert "agent: vehicle-00\n" in text
    return stage.repository.push({BRIDGE: text.replace("agent: vehicle-00\n", "agent: vehicle-01\n")}, "mine")


def test_an_edit_is_reverted_by_a_commit_that_names_it(stage: Stage) -> None:
    before = stage.releases()[BRIDGE]
    commit = edit(stage)
    stage.go(wake=DEPLOYMENT)
    message = last_message(stage)
    assert (REVERT in message.kinds, message.reverts) == (True, (commit,))
    assert stage.releases()[BRIDGE].same_but_plan(before)


def test_an_edit_is_respected_until_what_is_wanted_changes(stage: Stage) -> None:
    stage.repository.push({"policies/edits.yaml": "edits: respect\n"}, "policy")
    edit(stage)
    pulls = len(stage.forge.pulls)
    stage.go(20, seconds=1.0, wake=DEPLOYMENT)
    assert len(stage.forge.pulls) == pulls
    assert stage.releases()[BRIDGE].values["placement"] == {"agent": "vehicle-01"}
    stage.manager = stage.start()
    stage.go(10, seconds=1.0, wake=DEPLOYMENT)
    assert len(stage.forge.pulls) == pulls
    stage.ask()
    stage.go(6)
    assert stage.releases()[BRIDGE].values["placement"] == {"agent": "vehicle-00"}
    assert stage.tasks.condition(MEETING, "Committed") == ("True", "Merged")


def test_a_second_edit_is_respected_like_the_first(stage: Stage) -> None:
    stage.repository.push({"policies/edits.yaml": "edits: respect\n"}, "policy")
    edit(stage)
    stage.go(wake=DEPLOYMENT)
    text = stage.repository.trees[stage.repository.tip][BRIDGE]
    stage.repository.push({BRIDGE: text.replace("agent: vehicle-01\n", "agent: vehicle-02\n")}, "mine again")
    stage.go(wake=DEPLOYMENT)
    assert stage.releases()[BRIDGE].values["placement"] == {"agent": "vehicle-02"}


def test_a_release_that_a_person_removed_is_named_until_it_is_back(stage: Stage) -> None:
    stage.repository.push({EDITS_PATH: "edits: respect\n"}, "policy")
    key = stage.ask()
    stage.settle()
    path = "releases/cloud-0/recorder-vehicle-00-vehicle-01.yaml"
    text = stage.repository.files(stage.repository.tip, ("releases",))[path]
    commit = stage.repository.push({path: None}, "no recorder today")
    stage.go(wake=DEPLOYMENT)
    assert path not in stage.releases()
    assert stage.tasks.condition(key, "Committed") == ("False", "EditedByHand")
    said = next(c for c in stage.tasks.objects[key]["status"]["conditions"] if c["type"] == "Committed")["message"]
    assert f"{path} was removed by commit {commit[:12]} of manager. policies/edits.yaml respects that" in said
    assert "withdraw the task" in said
    assert ("EditedByHand", said) in [report[-2:] for report in stage.tasks.reports]
    stage.repository.push({path: text}, "back")
    stage.go(wake=DEPLOYMENT)
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")


def test_a_policy_that_cannot_be_read_leaves_the_one_before(stage: Stage) -> None:
    stage.repository.push({"policies/edits.yaml": "edits: respect\n"}, "policy")
    stage.go(wake=DEPLOYMENT)
    stage.repository.push({"policies/edits.yaml": "edits: perhaps\n"}, "policy")
    edit(stage)
    stage.go(wake=DEPLOYMENT)
    assert stage.releases()[BRIDGE].values["placement"] == {"agent": "vehicle-01"}


# -- changes of mind --


def test_a_withdrawal_closes_the_proposal_that_is_not_merged_yet(stage: Stage) -> None:
    stage.forge.decide = stage.forge.leave
    before = stage.releases()
    tip = stage.repository.tip
    key = stage.ask()
    stage.go(1)
    assert stage.forge.pulls[2].state == "open"
    stage.tasks.delete(key)
    stage.go(2)
    assert stage.forge.pulls[2].state == "closed"
    assert stage.forge.said[2][-1].text.startswith("Superseded: every task of this plan was withdrawn or changed")
    assert (stage.releases(), stage.repository.tip, len(stage.forge.pulls)) == (before, tip, 2)
    assert stage.manager.statistics.plans["superseded"] == 1


def test_a_change_of_the_only_task_makes_another_proposal(stage: Stage) -> None:
    stage.forge.decide = stage.forge.leave
    key = stage.ask()
    stage.go(1)
    stage.tasks.objects[key]["spec"]["parameters"] = {"vehicles": ["vehicle-01", "vehicle-02"]}
    stage.tasks.objects[key]["metadata"]["generation"] = 2
    stage.forge.decide = stage.forge.merge
    stage.go(3)
    assert [stage.forge.pulls[number].merged for number in (2, 3)] == [False, True]
    assert "releases/cloud-0/recorder-vehicle-01-vehicle-02.yaml" in stage.releases()
    assert "releases/cloud-0/recorder-vehicle-00-vehicle-01.yaml" not in stage.releases()


def test_one_of_two_withdrawn_keeps_the_proposal(stage: Stage) -> None:
    stage.forge.decide = stage.forge.leave
    first, second = stage.ask("a"), stage.ask("b", ("vehicle-01", "vehicle-02"))
    stage.go(1)
    stage.tasks.delete(first)
    stage.go(3)
    assert stage.forge.pulls[2].state == "open"
    stage.forge.decide = stage.forge.merge
    stage.forge.merge(stage.forge.pulls[2])
    stage.go(4)
    assert {c.task for release in stage.releases().values() for c in release.causes} == {second}


def test_a_gate_that_was_faster_than_the_withdrawal_is_answered_by_the_next_plan(stage: Stage) -> None:
    before = {path: release.values for path, release in stage.releases().items()}
    stage.forge.decide = stage.forge.leave
    key = stage.ask()
    stage.go(1)
    close = stage.forge.close

    def too_late(number: int) -> None:
        close(number)
        stage.forge.pulls[number] = replace(stage.forge.pulls[number], state="open")
        stage.forge.merge(stage.forge.pulls[number])

    stage.forge.close = too_late  # type: ignore[method-assign]
    stage.forge.decide = stage.forge.merge
    stage.tasks.delete(key)
    stage.go(6)
    assert {path: release.values for path, release in stage.releases().items()} == before
    assert last_message(stage).verb == "withdraw"


def test_statuses_say_when_main_moves_faster_than_the_gate_decides(stage: Stage) -> None:
    def overtake(pull: Any) -> None:
        stage.repository.push({"README.md": str(pull.number)})

    stage.forge.decide = overtake
    key = stage.ask()
    stage.go(ATTEMPTS_MAX + 4, seconds=0.01)
    assert stage.tasks.condition(key, "Committed") == ("False", "ForgeBusy")
    stage.forge.decide = stage.forge.merge
    stage.seconds += 60
    stage.go(4)
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")


# -- processes --


def test_a_new_process_takes_the_open_proposal_over(stage: Stage) -> None:
    stage.forge.decide = stage.forge.leave
    key = stage.ask()
    stage.go(1)
    plan = stage.plans()[-1]["plan"]
    stage.seconds += 5
    stage.manager = stage.start()
    stage.go(3)
    assert len(stage.forge.pulls) == 2
    assert (stage.plans()[-1]["plan"], stage.manager.statistics.plans["taken_over"]) == (plan, 1)
    assert stage.tasks.condition(key, "Committed") == ("False", "Proposed")
    stage.forge.merge(stage.forge.pulls[2])
    stage.forge.decide = stage.forge.merge
    stage.settle()
    assert stage.tasks.condition(key, "Ready") == ("True", "Observed")
    assert len([c for c in stage.repository.log(None, 100) if f"RobotKube-Plan: {plan}" in c.message]) == 1


def test_a_new_process_closes_what_it_does_not_want(stage: Stage) -> None:
    stage.forge.decide = stage.forge.leave
    key = stage.ask()
    stage.go(1)
    stage.tasks.delete(key)
    stage.manager = stage.start()
    stage.forge.decide = stage.forge.merge
    stage.go(3)
    assert (stage.forge.pulls[2].state, stage.forge.pulls[2].merged) == ("closed", False)
    assert len(stage.releases()) == 5


def test_a_process_that_does_not_lead_does_nothing(stage: Stage) -> None:
    stage.leadership.number = None
    stage.ask()
    stage.go(10, seconds=1.0)
    assert len(stage.forge.pulls) == 1
    assert "status" not in stage.tasks.objects[MEETING]
    stage.leadership.number = 2
    stage.go(4)
    assert stage.tasks.condition(MEETING, "Committed") == ("True", "Merged")
    assert last_message(stage).term == 2


def test_a_process_that_waits_is_ready_when_it_could_take_over(stage: Stage) -> None:
    stage.leadership.number = None
    stage.manager = stage.start()
    assert stage.manager.reasons_not_ready() == ["has not read main and the cluster yet"]
    stage.go(1)
    assert stage.manager.reasons_not_ready() == []
    stage.leadership.other = None
    assert stage.manager.reasons_not_ready() == ["no process of this manager is known to lead"]
    stage.leadership.other = "another:8080"
    stage.repository.away = True
    stage.ask()
    stage.seconds += 40
    stage.fail()
    [late, problem] = stage.manager.reasons_not_ready()
    assert late == "the forge was not seen for 40 s"
    assert problem == "the forge does not answer"
    assert "status" not in stage.tasks.objects[MEETING]  # to say so is the leader's


def test_leadership_that_is_lost_while_a_plan_is_computed_stops_its_proposal(stage: Stage) -> None:
    planner = stage.manager.planner
    plan = planner.plan

    def lose(started: int) -> Plan | None:
        stage.leadership.number = None
        return plan(started)

    planner.plan = lose  # type: ignore[method-assign]
    stage.ask()
    stage.go(3)
    assert len(stage.forge.pulls) == 1


def test_a_process_behind_main_is_elected_again_with_a_higher_term(stage: Stage) -> None:
    made = last_message(stage)
    ahead = write_message(replace(made, plan="20261121-100000-abcdef", term=41))
    stage.repository.push({"README.md": "of another cluster"}, ahead)
    stage.manager = stage.start()
    stage.ask()
    stage.go(6)
    assert stage.tasks.condition(MEETING, "Committed") == ("True", "Merged")
    assert last_message(stage).term == stage.leadership.number == 42


def test_a_failure_is_over_with_the_next_step_though_a_proposal_waits(stage: Stage) -> None:
    stage.forge.decide = stage.forge.leave
    stage.ask()
    stage.go(2)
    stage.repository.away = True
    stage.seconds += RESYNC_SECONDS
    stage.fail()
    assert stage.manager.reasons_not_ready() == ["the forge does not answer"]
    stage.repository.away = False
    stage.go(1)
    assert stage.manager.reasons_not_ready() == []


# -- outcome comments --


def test_what_was_observed_is_written_once_into_the_pull_request(stage: Stage) -> None:
    stage.ask()
    stage.settle()
    assert stage.forge.said[2] == []
    stage.go(6, seconds=QUIET_SECONDS)
    [said] = stage.forge.said[2]
    plan = stage.plans()[-1]
    assert said.text.startswith(f"Observed plan `{plan['plan']}`, commit {plan['commit'][:12]}.")
    assert "- `vehicle-00/mqtt-bridge`: Synced, Healthy" in said.text
    note = read_note(said.text, plan["commit"])
    assert note is not None
    assert plan["plan"] in note
    assert read_note(said.text, "0" * 40) is None
    assert read_note(said.text.replace("Observed", "Refused"), plan["commit"]) is None


def test_closing_words_wait_for_a_forge_that_is_away(stage: Stage, tmp_path: Path) -> None:
    stage.ask()
    stage.settle()
    comment = stage.forge.comment
    stage.repository.away = True

    def reached(number: int, text: str) -> None:
        stage.repository._reach()
        comment(number, text)

    stage.forge.comment = reached  # type: ignore[method-assign]
    stage.seconds += 2 * QUIET_SECONDS
    stage.fail()
    stage.repository.away = False
    stage.go(6, seconds=QUIET_SECONDS)
    assert len(stage.forge.said[2]) == 1
