"""The manager's Git side against a real forge and the real gate: one AGit push per plan, the gate's decision, statuses.

The cluster is in memory: it shows what main asks for as soon as a test says so.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.deployment.core.commit_messages import read_message
from robotkube.delivery.deployment.core.releases import Release, read_tree, write_release
from robotkube.delivery.manager.loops.reconciler import APPLICATIONS, DEPLOYMENT, TASKS
from robotkube.delivery.manager.loops.reconciler import CATALOGUE as CATALOGUE_MOVED
from robotkube.testing.clusters import MemoryTasks
from tests.stages.delivery.manager.manager_process import AGENTS
from tests.stages.delivery.manager.running_manager import RunningManager, start_manager
from tests.stages.forge.catalogue_evidence import unproved_chart
from tests.stages.forge.installation import (
    CATALOGUE,
    ApplicationSetController,
    Installation,
    RunningGate,
    start_gate,
)
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

KEY = "cloud-0/meeting"


def releases(installation: Installation) -> dict[str, Release]:
    """Main's releases, read by somebody else."""
    clone = installation.clone("argocd")
    tree = clone.repository[clone.tip()].tree
    files: dict[str, str] = {}

    def collect(entries: Any, prefix: str) -> None:
        for entry in entries:
            path = f"{prefix}{entry.name}"
            if entry.type_str == "tree":
                collect(entry, f"{path}/")
            elif path.endswith(".yaml") and path.startswith(("releases/", "sources/")):
                files[path] = entry.data.decode()

    collect(tree, "")
    main = read_tree(files)
    assert main.problems == ()
    return dict(main.releases)


@pytest.fixture
def manager(installation: Installation, gate: RunningGate, tmp_path: Path) -> Iterator[RunningManager]:
    started = start_manager(installation, tmp_path, MemoryTasks())
    until(lambda: started.manager.reasons_not_ready() == [], "ready")
    initial = {f"releases/{name}/mqtt-bridge.yaml" for name, _ in AGENTS}
    until(lambda: initial <= set(releases(installation)), "initial configuration merged")
    until(lambda: all(p["on_main"] or p["error"] for p in started.plans()), "initial configuration seen")
    yield started
    started.stop()


def ask(tasks: MemoryTasks, vehicles: tuple[str, str] = ("vehicle-00", "vehicle-01")) -> None:
    spec = {
        "requester": "cloud-0/event-detector",
        "event": {"rule": "lidar-proximity", "id": "3f2a9c", "trace": "1e3" + "0" * 29, "time": "2026-11-21T10:00:00Z"},
        "reason": f"{', '.join(vehicles)} within 400 m",
        "application": "pose-point-cloud-recording",
        "parameters": {"vehicles": list(vehicles)},
    }
    tasks.create("cloud-0", "meeting", spec)


def test_a_task_becomes_a_commit_on_main_and_its_withdrawal_another(
    installation: Installation, controller: ApplicationSetController, manager: RunningManager
) -> None:
    before = {path: release.values for path, release in releases(installation).items()}
    ask(manager.tasks)
    manager.manager.wake(TASKS)
    until(lambda: len(installation.client("gate").get("/pulls").json()) > 0 or committed(manager), "proposed")
    until(lambda: committed(manager), "committed")
    status = manager.tasks.objects[KEY]["status"]
    plan = manager.plans()[-1]
    number = status["pullRequest"]["number"]
    until(lambda: installation.pull_request(number)["merged"], "marked merged by the forge")
    pull = installation.pull_request(number)
    assert pull["merge_commit_sha"] == status["commit"] == plan["commit"]
    assert pull["title"] == "deploy(recording): vehicle-00, vehicle-01 within 400 m"
    assert pull["html_url"] == status["pullRequest"]["url"]
    assert "cloud-0/recorder-vehicle-00-vehicle-01" in pull["body"]
    assert "releases/cloud-0/recorder-vehicle-00-vehicle-01.yaml" in releases(installation)
    until(lambda: controller.announced(plan["commit"]), "announced")
    manager.cluster.settle(releases(installation))
    manager.manager.wake(APPLICATIONS)
    until(lambda: manager.tasks.condition(KEY, "Ready") == ("True", "Observed"), "observed")
    manager.tasks.delete(KEY)
    manager.manager.wake(TASKS)
    until(lambda: manager.plans()[-1]["cause"] == "withdrawal" and manager.last_plan_is("merged"), "withdrawn")
    commit = manager.deployment.commit(manager.plans()[-1]["commit"])
    assert commit.author == "robotkube-manager"
    assert [cause.task for cause in read_message(commit.message).causes] == [KEY]
    assert {path: release.values for path, release in releases(installation).items()} == before


def committed(manager: RunningManager) -> bool:
    return manager.tasks.condition(KEY, "Committed") == ("True", "Merged")


def test_a_restarted_manager_finds_pull_request_and_commit_again(
    installation: Installation, manager: RunningManager, tmp_path: Path
) -> None:
    ask(manager.tasks)
    manager.manager.wake(TASKS)
    until(lambda: committed(manager), "committed")
    manager.stop()
    status = manager.tasks.objects[KEY].pop("status")
    again = start_manager(installation, tmp_path / "again", manager.tasks)
    try:
        until(lambda: committed(again), "committed again")
        status = again.tasks.objects[KEY]["status"]
        assert {k: status[k] for k in ("plan", "commit", "pullRequest")} == {
            k: status[k] for k in ("plan", "commit", "pullRequest")
        }
        again.tasks.delete(KEY)
        again.manager.wake(DEPLOYMENT)
        again.manager.wake(TASKS)
        until(lambda: again.plans()[-1]["cause"] == "withdrawal" and again.last_plan_is("merged"), "withdrawn")
    finally:
        again.stop()


def test_with_the_gate_away_the_plan_waits_and_goes_on_when_it_is_back(
    installation: Installation,
    manager: RunningManager,
    gate: RunningGate,
    controller: ApplicationSetController,
    tmp_path: Path,
) -> None:
    gate.stop()
    ask(manager.tasks)
    manager.manager.wake(TASKS)
    until(lambda: manager.tasks.condition(KEY, "Committed") == ("False", "Proposed"), "proposed")
    assert manager.last_plan_is("proposed")
    assert not manager.last_plan_is("merged")
    plan = manager.plans()[-1]
    again = start_gate(installation, controller.url, tmp_path / "gate-again")
    try:
        until(lambda: committed(manager), "committed")
        log = manager.deployment.log(None, 1000)
        assert [c.id for c in log if f"RobotKube-Plan: {plan['plan']}" in c.message] == [plan["commit"]]
        manager.tasks.delete(KEY)
        manager.manager.wake(TASKS)
        until(lambda: manager.plans()[-1]["cause"] == "withdrawal" and manager.last_plan_is("merged"), "withdrawn")
    finally:
        again.stop()


def test_an_entry_edited_to_verified_without_evidence_is_no_verified_version(
    installation: Installation, manager: RunningManager
) -> None:
    """Somebody who may write the catalogue writes a newer version of the detector by hand, and withdraws the proved."""
    digest = "sha256:" + "d" * 64
    version = "0.2.4"
    proved = CATALOGUE["charts/event-detector/0.2.3.yaml"]
    edited = unproved_chart("event-detector", version, digest)
    edited["charts/event-detector/0.2.3.yaml"] = proved.replace("state: verified", "state: withdrawn")
    installation.publish(edited)
    try:
        manager.manager.wake(CATALOGUE_MOVED)
        until(lambda: version in str(manager.manager.catalogue_page()), "catalogue read")
        ask(manager.tasks)
        manager.manager.wake(TASKS)
        until(lambda: manager.tasks.condition(KEY, "Accepted")[0] == "False", "refused")
        assert manager.tasks.condition(KEY, "Accepted") == ("False", "NoVerifiedVersion")
        text = manager.tasks.objects[KEY]["status"]["conditions"][0]["message"]
        assert "event-detector 0.2.4 (verified): no valid evidence: suite static: there is no evidence" in text
        assert "event-detector 0.2.3 (withdrawn): state withdrawn is not allowed" in text
        assert manager.tasks.reports == [(KEY, "NoVerifiedVersion", text)]
    finally:
        manager.tasks.delete(KEY)
        installation.publish(
            {
                **dict.fromkeys(edited),
                "charts/event-detector/0.2.3.yaml": proved,
                "charts/event-detector/0.2.3.schema.json": CATALOGUE["charts/event-detector/0.2.3.schema.json"],
            }
        )


def test_a_new_process_takes_an_open_proposal_over_and_closes_another(
    installation: Installation,
    manager: RunningManager,
    gate: RunningGate,
    controller: ApplicationSetController,
    tmp_path: Path,
) -> None:
    gate.stop()
    ask(manager.tasks)
    manager.manager.wake(TASKS)
    until(lambda: manager.tasks.condition(KEY, "Committed") == ("False", "Proposed"), "proposed")
    number = manager.tasks.objects[KEY]["status"]["pullRequest"]["number"]
    plan = manager.plans()[-1]["plan"]
    manager.stop()
    clone = installation.clone("manager")
    topic = installation.plan()
    unwanted = installation.propose(clone, clone.commit({"README.md": "x\n"}, "x\n", [clone.tip()]), topic)
    again = start_manager(installation, tmp_path / "again", manager.tasks)
    try:
        until(lambda: again.manager.statistics.plans["taken_over"] == 1, "taken over")
        assert again.plans()[-1]["plan"] == plan
        until(lambda: installation.pull_request(unwanted)["state"] == "closed", "closed by its author")
        assert "Superseded: the manager began anew" in installation.comments(unwanted)
        running = start_gate(installation, controller.url, tmp_path / "gate-again")
        try:
            until(lambda: committed(again), "committed")
            assert again.tasks.objects[KEY]["status"]["pullRequest"]["number"] == number
            again.tasks.delete(KEY)
            again.manager.wake(TASKS)
            until(lambda: again.plans()[-1]["cause"] == "withdrawal" and again.last_plan_is("merged"), "withdrawn")
        finally:
            running.stop()
    finally:
        again.stop()


def test_a_file_broken_past_the_gate_is_named_and_repaired(
    installation: Installation,
    manager: RunningManager,
    gate: RunningGate,
    controller: ApplicationSetController,
    tmp_path: Path,
) -> None:
    path = "releases/vehicle-00/mqtt-bridge.yaml"
    before = releases(installation)[path]
    gate.stop()
    person = installation.clone("gate")
    broken = person.commit({path: "kind: [\n", "releases/vehicle-01/empty.yaml": ""}, "By hand\n", [person.tip()])
    assert person.push(broken, "refs/heads/main") == ""
    ask(manager.tasks)
    manager.manager.wake(TASKS)
    until(lambda: manager.tasks.condition(KEY, "Committed") == ("False", "MainBroken"), "named")
    assert manager.manager.statistics.broken_files == 2
    again = start_gate(installation, controller.url, tmp_path / "gate-again")
    try:
        until(lambda: committed(manager), "repaired, and the task answered")
        repair = next(c for c in manager.deployment.log(broken, 10) if "RobotKube-Cause: repair" in c.message)
        assert repair.parents == (broken,)
        assert read_message(repair.message).reverts == (broken,)
        assert repair.changes["releases/vehicle-01/empty.yaml"] is None
        verdicts = again.gate.statistics.verdicts
        until(lambda: (verdicts["accepted"], verdicts["refused"]) == (2, 0), "nothing else was merged or refused")
        manager.tasks.delete(KEY)
        manager.manager.wake(TASKS)
        until(lambda: manager.plans()[-1]["cause"] == "withdrawal" and manager.last_plan_is("merged"), "withdrawn")
        assert releases(installation)[path].same_but_plan(before)
    finally:
        again.stop()


def test_an_edit_by_hand_is_reverted_by_a_commit_that_names_it(
    installation: Installation, manager: RunningManager
) -> None:
    path = "releases/vehicle-00/mqtt-bridge.yaml"
    before = releases(installation)[path]
    person = installation.clone("gate")
    edited = write_release(replace(before, values={**before.values, "placement": {"agent": "vehicle-01"}}))
    commit = person.commit({path: edited}, "By hand\n", [person.tip()])
    assert person.push(commit, "refs/heads/main") == ""
    manager.manager.wake(DEPLOYMENT)
    until(lambda: releases(installation)[path].same_but_plan(before), "reverted")
    commits = manager.deployment.log(commit, 10) or [manager.deployment.commit(installation.clone("gate").tip())]
    message = read_message(commits[-1].message)
    assert ("revert" in message.kinds, message.reverts) == (True, (commit,))
