"""Pull requests of people: merged by the gate alone, when another person approved exactly what it checked."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import pygit2
import pytest

from robotkube.delivery.deployment.loops.main_history import term_of
from tests.stages.attacks import shown
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
RESPECT = {"policies/edits.yaml": "edits: respect\n"}


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
    """Return whether the pull request is still open after two more rounds in which approvals are looked at."""
    rounds = gate.gate.statistics.rounds
    for more in (1, 2):
        gate.gate._resync_due = True
        gate.gate._woken.set()
        until(lambda more=more: gate.gate.statistics.rounds >= rounds + more, "two rounds")
    return installation.pull_request(number)["state"] == "open"


def close(installation: Installation, number: int) -> None:
    installation.client("gate").patch(f"/pulls/{number}", json={"state": "closed"}).raise_for_status()


def changed(clone: Clone) -> tuple[pygit2.Commit, Mapping[str, str | None]]:
    """Main's newest commit, and what it changes of its first parent."""
    newest = clone.repository[clone.tip()]
    assert isinstance(newest, pygit2.Commit)
    deltas = newest.parents[0].tree.diff_to_tree(newest.tree).deltas
    paths = [delta.new_file.path for delta in deltas]
    texts = {path: newest.tree[path].data.decode() if path in newest.tree else None for path in paths}
    return newest, texts


def merged_as(clone: Clone, before: str, head: str, changes: Mapping[str, str | None]) -> pygit2.Commit:
    """Main's tip, which joins `before` and the approved head and changes that alone, as far as main did not have it."""
    newest, texts = changed(clone)
    assert [str(parent) for parent in newest.parent_ids] == [before, head]
    tree = newest.parents[0].tree
    assert texts == {
        path: text for path, text in changes.items() if path not in tree or tree[path].data.decode() != text
    }
    assert texts
    return newest


def test_a_policy_waits_for_another_person_and_is_merged_as_it_was_approved(
    installation: Installation, gate: RunningGate, controller: ApplicationSetController, person: Clone
) -> None:
    tip = person.tip()
    changes = {"policies/initial.yaml": INITIAL.format(0)}
    commit = person.commit(changes, "Take vehicle-00 away\n\nRobotKube-Approved-By: me\n", [tip])
    number = installation.propose(person, commit, installation.plan())
    text = said(installation, number, f"Checked {commit[:12]}: nothing speaks against it.")
    assert "the gate merges what exactly this commit changes when another person with write rights approves it" in text
    assert review(installation, "operator-team", number, commit) in (403, 422)  # nobody approves for himself
    assert review(installation, "manager", number, commit) == 200  # it may say so, and it does not count
    assert review(installation, "gate", number, commit) == 200  # nor does what is said with the gate's own account
    assert settled(installation, gate, number)
    assert person.tip() == tip
    assert review(installation, "reviewer", number, commit) == 200
    until(lambda: installation.pull_request(number)["merged"], "merged")
    newest = merged_as(person, tip, commit, changes)
    assert (newest.author.name, newest.committer.name) == ("operator-team", "gate")
    trailers = f"RobotKube-Pull-Request: {number}\nRobotKube-Approved-By: reviewer\n"
    assert newest.message == f"Take vehicle-00 away (#{number})\n\n{trailers}"
    assert installation.pull_request(number)["merge_commit_sha"] == str(newest.id)
    until(lambda: controller.announced(str(newest.id)), "announced")
    assert installation.comments(number).count("Checked ") == 1


def test_an_approval_of_an_earlier_head_does_not_count(
    installation: Installation, gate: RunningGate, person: Clone
) -> None:
    tip = person.tip()
    topic = installation.plan()
    first = person.commit({"policies/initial.yaml": INITIAL.format(1)}, "One\n", [tip])
    changes = {"policies/initial.yaml": "add: []\nremove: []\n# two\n"}
    second = person.commit(changes, "Two\n", [tip])
    number = installation.propose(person, first, topic)
    said(installation, number, f"Checked {first[:12]}")
    assert person.push(second, "refs/for/main", [f"topic={topic}", "force-push=true"]) == ""
    assert review(installation, "reviewer", number, first) == 200
    said(installation, number, f"Checked {second[:12]}")
    assert settled(installation, gate, number)
    assert person.tip() == tip
    assert review(installation, "reviewer", number, second) == 200
    until(lambda: installation.pull_request(number)["merged"], "merged")
    merged_as(person, tip, second, changes)


def test_somebody_against_it_holds_it(installation: Installation, gate: RunningGate, person: Clone) -> None:
    commit = person.commit({"policies/initial.yaml": INITIAL.format(1)}, "Take it\n", [person.tip()])
    number = installation.propose(person, commit, installation.plan())
    said(installation, number, f"Checked {commit[:12]}")
    assert review(installation, "reviewer", number, commit, "REQUEST_CHANGES") == 200
    assert settled(installation, gate, number)
    close(installation, number)


def test_what_the_gate_refuses_reaches_main_by_nobody_though_edits_are_to_be_respected(
    installation: Installation, gate: RunningGate, person: Clone
) -> None:
    """The attack: a release that the gate refuses, and in the same commit the policy that lets it stay."""
    tip = person.tip()
    commit = person.commit(
        {**release_files(installation.plan(), "by-a-person", values={"x": 1}), **RESPECT}, "Let it\n", [tip]
    )
    number = installation.propose(person, commit, installation.plan())
    text = said(installation, number, f"Checked {commit[:12]}: it cannot be merged.")
    assert "releases/cloud-0/by-a-person.yaml: spec.values: Additional properties are not allowed" in text
    assert "Main moves by the gate alone, so nobody can merge it" in text
    shown("gate", text, "merge-against-the-gate")
    assert review(installation, "reviewer", number, commit) == 200
    assert settled(installation, gate, number)
    for account in ("operator-team", "reviewer", "manager"):
        for style in ("fast-forward-only", "rebase", "merge", "squash", "manually-merged"):
            body = {"Do": style, "MergeCommitID": commit, "force_merge": True}
            assert installation.client(account).post(f"/pulls/{number}/merge", json=body).status_code in (403, 405, 409)
    assert person.push(commit, "refs/heads/main") != ""
    assert settled(installation, gate, number)
    assert person.tip() == tip
    assert installation.comments(number).count("Checked ") == 1
    close(installation, number)


def test_every_mistake_is_named(installation: Installation, gate: RunningGate, person: Clone) -> None:
    commit = person.commit({"policies/merge.yaml": "other: 1\n", **RESPECT}, "Correct it\n", [person.tip()])
    number = installation.propose(person, commit, installation.plan())
    assert "policies/merge.yaml: other: unknown key; remove it" in said(installation, number, "it cannot be merged.")
    close(installation, number)


def test_a_good_release_of_a_person_needs_an_approval_as_well(
    installation: Installation, gate: RunningGate, person: Clone
) -> None:
    """Its message pretends to be a manager's plan; on main stands the gate's own."""
    plan = installation.plan()
    tip = person.tip()
    files = release_files(plan, "person")
    commit = person.commit(files, message(plan), [tip])
    number = installation.propose(person, commit, plan)
    said(installation, number, f"Checked {commit[:12]}: nothing speaks against it.")
    assert settled(installation, gate, number)
    assert review(installation, "reviewer", number, commit) == 200
    until(lambda: installation.pull_request(number)["merged"], "merged")
    assert term_of(message(plan)) is not None
    assert term_of(merged_as(person, tip, commit, files).message) is None


def test_a_branch_of_several_commits_behind_main_is_merged_where_main_left_its_files_alone(
    installation: Installation, gate: RunningGate, person: Clone
) -> None:
    base = person.tip()
    wrong = person.commit({"policies/other.yaml": "a: ["}, "Not yet right\n", [base])
    changes = {"policies/other.yaml": "a: 1\n", "README.md": "better\n"}
    commit = person.commit(changes, "Right\n", [wrong])
    number = installation.propose(person, commit, installation.plan())
    said(installation, number, f"Checked {commit[:12]}: nothing speaks against it.")
    manager = installation.clone("manager")
    plan = installation.plan()
    theirs = manager.commit(release_files(plan, "meanwhile"), message(plan), [manager.tip()])
    other = installation.propose(manager, theirs, plan)
    until(lambda: installation.pull_request(other)["merged"], "the manager's merged")
    assert review(installation, "reviewer", number, commit) == 200
    until(lambda: installation.pull_request(number)["merged"], "merged")
    newest = merged_as(person, theirs, commit, changes)
    assert newest.tree["releases/cloud-0/meanwhile.yaml"]


def test_where_main_changed_the_same_file_the_branch_is_updated_and_approved_anew(
    installation: Installation, gate: RunningGate, person: Clone
) -> None:
    base = person.tip()
    topic = installation.plan()
    commit = person.commit({"policies/both.yaml": "a: 1\n"}, "Mine\n", [base])
    number = installation.propose(person, commit, topic)
    said(installation, number, f"Checked {commit[:12]}: nothing speaks against it.")
    of_gate = installation.clone("gate")
    tip = of_gate.commit({"policies/both.yaml": "a: 2\n"}, "Theirs\n", [of_gate.tip()])
    assert of_gate.push(tip, "refs/heads/main") == ""
    assert review(installation, "reviewer", number, commit) == 200
    text = said(installation, number, f"Checked {commit[:12]}: it cannot be merged before its branch is updated.")
    assert "policies/both.yaml: main has changed this file as well" in text
    assert settled(installation, gate, number)
    assert person.tip() == tip
    updated = person.commit({"policies/both.yaml": "a: 3\n"}, "Both\n", [commit, tip])
    assert person.push(updated, "refs/for/main", [f"topic={topic}", "force-push=true"]) == ""
    said(installation, number, f"Checked {updated[:12]}: nothing speaks against it.")
    assert settled(installation, gate, number)
    assert review(installation, "reviewer", number, updated) == 200
    until(lambda: installation.pull_request(number)["merged"], "merged")
    merged_as(person, tip, updated, {"policies/both.yaml": "a: 3\n"})


def test_what_no_policy_names_is_merged_by_nobody_before_one_does(
    installation: Installation, gate: RunningGate, person: Clone
) -> None:
    tip = person.tip()
    commit = person.commit({"notes.txt": "better\n"}, "Words\n", [tip])
    number = installation.propose(person, commit, installation.plan())
    text = said(installation, number, f"Checked {commit[:12]}: nothing speaks against it.")
    assert "policies/merge.yaml names no way to main for these files: name them under `person` there" in text
    assert review(installation, "reviewer", number, commit) == 200
    assert settled(installation, gate, number)
    assert person.tip() == tip
    wider = {"policies/merge.yaml": MERGE_POLICY.replace("README.md]", "README.md, notes.txt]")}
    policy = person.commit(wider, "Open it\n", [tip])
    opening = installation.propose(person, policy, installation.plan())
    said(installation, opening, f"Checked {policy[:12]}: nothing speaks against it.")
    assert review(installation, "reviewer", opening, policy) == 200
    until(lambda: installation.pull_request(opening)["merged"], "the policy merged")
    gate.gate._resync_due = True
    gate.gate._woken.set()
    until(lambda: installation.pull_request(number)["merged"], "merged by the new policy")


@pytest.fixture
def strict(installation: Installation) -> Iterator[None]:
    """Main's policy lets nothing merge by itself, as long as the test runs."""
    gate = installation.clone("gate")

    def write(text: str) -> None:
        commit = gate.commit({"policies/merge.yaml": text}, "policy\n", [gate.tip()])
        assert gate.push(commit, "refs/heads/main") == ""

    write("automatic: [{author: operator-team, paths: [policies/]}]\nperson: [{paths: [releases/, sources/]}]\n")
    yield
    write(MERGE_POLICY)


def test_main_says_whether_a_managers_plan_merges_by_itself(
    installation: Installation, strict: None, gate: RunningGate
) -> None:
    manager = installation.clone("manager")
    plan = installation.plan()
    commit = manager.commit(release_files(plan, "approved"), message(plan), [manager.tip()])
    number = installation.propose(manager, commit, plan)
    text = said(installation, number, f"Waits for approval: {commit[:12]} passes the checks.")
    assert "when another person with write rights approves it" in text
    assert settled(installation, gate, number)
    assert review(installation, "operator-team", number, commit) == 200
    until(lambda: installation.pull_request(number)["merged"], "merged")
    assert manager.tip() == commit


def test_no_policy_lets_a_persons_change_merge_by_itself(
    installation: Installation, strict: None, gate: RunningGate, person: Clone
) -> None:
    commit = person.commit({"policies/initial.yaml": INITIAL.format(1)}, "By myself\n", [person.tip()])
    number = installation.propose(person, commit, installation.plan())
    said(installation, number, "names no way to main for these files")
    assert settled(installation, gate, number)
    close(installation, number)


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
