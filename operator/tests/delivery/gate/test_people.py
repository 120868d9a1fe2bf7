"""Pull requests of people: checked and commented once, merged by the gate exactly as approved, never otherwise."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.stages.forge.installation import (
    MERGE_POLICY,
    ApplicationSetController,
    Clone,
    Installation,
    RunningGate,
    message,
    release_files,
    start_gate,
)
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

INITIAL = "add: []\nremove: [{{application: mqtt-bridge, agents: [vehicle-0{}]}}]\n"


@pytest.fixture
def person(installation: Installation) -> Clone:
    return installation.clone("operator-team")


def said(installation: Installation, number: int, words: str) -> str:
    """The comments of a pull request as soon as they hold `words`."""
    until(lambda: words in installation.comments(number), f"said: {words}")
    return installation.comments(number)


def review(installation: Installation, account: str, number: int, commit: str, event: str = "APPROVED") -> int:
    """Status of the forge's answer."""
    body = {"event": event, "commit_id": commit, "body": "seen"}
    return installation.client(account).post(f"/pulls/{number}/reviews", json=body).status_code


def settled(installation: Installation, gate: RunningGate, number: int) -> bool:
    """Whether the pull request is still open after two more rounds in which approvals are looked at."""
    rounds = gate.gate.statistics.rounds
    for more in (1, 2):
        gate.gate._resync_due = True
        gate.gate._woken.set()
        until(lambda more=more: gate.gate.statistics.rounds >= rounds + more, "two rounds")
    return installation.pull_request(number)["state"] == "open"


def close(installation: Installation, number: int) -> None:
    installation.client("gate").patch(f"/pulls/{number}", json={"state": "closed"}).raise_for_status()


def test_a_policy_waits_for_an_approval_and_is_merged_exactly_as_approved(
    installation: Installation, gate: RunningGate, controller: ApplicationSetController, person: Clone
) -> None:
    commit = person.commit({"policies/initial.yaml": INITIAL.format(0)}, "Take vehicle-00 away\n", [person.tip()])
    number = installation.propose(person, commit, installation.plan())
    text = said(installation, number, f"Checked {commit[:12]}: nothing speaks against it.")
    assert "the gate merges exactly this commit when another person with write rights approves it" in text
    assert review(installation, "operator-team", number, commit) in (403, 422)  # nobody approves for himself
    assert review(installation, "manager", number, commit) == 200  # it may say so, and it does not count
    assert settled(installation, gate, number)
    assert review(installation, "reviewer", number, commit) == 200
    until(lambda: installation.pull_request(number)["merged"], "merged")
    assert person.tip() == commit
    assert installation.pull_request(number)["merged_by"]["login"] == "gate"
    until(lambda: controller.announced(commit), "announced")
    assert installation.comments(number).count("Checked ") == 1


def test_an_approval_of_an_earlier_head_does_not_count(
    installation: Installation, gate: RunningGate, person: Clone
) -> None:
    tip, topic = person.tip(), installation.plan()
    first = person.commit({"policies/initial.yaml": INITIAL.format(1)}, "One\n", [tip])
    second = person.commit({"policies/initial.yaml": "add: []\nremove: []\n# two\n"}, "Two\n", [tip])
    number = installation.propose(person, first, topic)
    said(installation, number, f"Checked {first[:12]}")
    assert person.push(second, "refs/for/main", [f"topic={topic}", "force-push=true"]) == ""
    assert review(installation, "reviewer", number, first) == 200
    said(installation, number, f"Checked {second[:12]}")
    assert settled(installation, gate, number)
    assert person.tip() == tip
    assert review(installation, "reviewer", number, second) == 200
    until(lambda: installation.pull_request(number)["merged"], "merged")
    assert person.tip() == second


def test_somebody_against_it_holds_it(installation: Installation, gate: RunningGate, person: Clone) -> None:
    commit = person.commit({"policies/initial.yaml": INITIAL.format(1)}, "Take it\n", [person.tip()])
    number = installation.propose(person, commit, installation.plan())
    said(installation, number, f"Checked {commit[:12]}")
    assert review(installation, "reviewer", number, commit, "REQUEST_CHANGES") == 200
    assert settled(installation, gate, number)
    close(installation, number)


def test_what_is_wrong_is_said_once_per_commit_and_not_merged_though_approved(
    installation: Installation, gate: RunningGate, person: Clone
) -> None:
    files = {**release_files(installation.plan(), "by-a-person", values={"x": 1}), "policies/merge.yaml": "other: 1\n"}
    commit = person.commit(files, "Correct it\n", [person.tip()])
    number = installation.propose(person, commit, installation.plan())
    text = said(installation, number, f"Checked {commit[:12]}: the gate would not merge this.")
    assert "releases/cloud-0/by-a-person.yaml: spec.values: Additional properties are not allowed" in text
    assert "policies/merge.yaml: other: unknown key; remove it" in text
    assert review(installation, "reviewer", number, commit) == 200
    said(installation, number, f"Approved {commit[:12]}, but the gate cannot merge it.")
    assert settled(installation, gate, number)
    assert installation.comments(number).count("Checked ") == 1
    close(installation, number)


def test_a_good_release_of_a_person_needs_an_approval_as_well(
    installation: Installation, gate: RunningGate, person: Clone
) -> None:
    plan = installation.plan()
    commit = person.commit(release_files(plan, "person"), "Bring it back\n", [person.tip()])
    number = installation.propose(person, commit, plan)
    said(installation, number, f"Checked {commit[:12]}: nothing speaks against it.")
    assert settled(installation, gate, number)
    assert review(installation, "reviewer", number, commit) == 200
    until(lambda: installation.pull_request(number)["merged"], "merged")


def test_what_no_policy_names_is_left_to_the_forge(
    installation: Installation, gate: RunningGate, person: Clone
) -> None:
    commit = person.commit({"README.md": "better\n"}, "Words\n", [person.tip()])
    number = installation.propose(person, commit, installation.plan())
    said(installation, number, "does not let the gate merge it: people do that in the forge.")
    assert review(installation, "reviewer", number, commit) == 200
    assert settled(installation, gate, number)
    close(installation, number)


@pytest.fixture
def strict(installation: Installation) -> Iterator[None]:
    """Main's policy lets nothing merge by itself, as long as the test runs."""
    gate = installation.clone("gate")

    def write(text: str) -> None:
        commit = gate.commit({"policies/merge.yaml": text}, "policy\n", [gate.tip()])
        assert gate.push(commit, "refs/heads/main") == ""

    write("automatic: []\nperson: [{paths: [releases/, sources/]}]\n")
    yield
    write(MERGE_POLICY)


def test_main_says_whether_a_managers_plan_merges_by_itself(
    installation: Installation, strict: None, gate: RunningGate
) -> None:
    manager, plan = installation.clone("manager"), installation.plan()
    commit = manager.commit(release_files(plan, "approved"), message(plan), [manager.tip()])
    number = installation.propose(manager, commit, plan)
    text = said(installation, number, f"Waits for approval: {commit[:12]} passes the checks.")
    assert "when another person with write rights approves it" in text
    assert settled(installation, gate, number)
    assert review(installation, "operator-team", number, commit) == 200
    until(lambda: installation.pull_request(number)["merged"], "merged")
    assert manager.tip() == commit


def test_a_restarted_gate_does_not_say_it_again(
    installation: Installation, controller: ApplicationSetController, tmp_path: Path, person: Clone
) -> None:
    commit = person.commit({"policies/initial.yaml": INITIAL.format(1)}, "Once\n", [person.tip()])
    number = installation.propose(person, commit, installation.plan())
    for folder in ("first", "second"):
        running = start_gate(installation, controller.url, tmp_path / folder)
        try:
            said(installation, number, f"Checked {commit[:12]}")
            assert settled(installation, running, number)
        finally:
            running.stop()
    assert installation.comments(number).count("Checked ") == 1
    close(installation, number)
