"""Outcome comments of managers become Git notes, written by the gate alone: real forge, real Git."""

import time
from collections.abc import Iterator
from pathlib import Path

import pygit2
import pytest

from robotkube.delivery.deployment.core.plan_notes import PlanOutcome, ReleaseOutcome, note_text, outcome_comment
from robotkube.delivery.gate.loops.plan_notes import NoteWriter
from robotkube.foundation.forge.adapters.git.notes import REFERENCE, GitNotes
from robotkube.foundation.forge.adapters.hosts.gitea import GiteaForge
from tests.stages.forge.installation import Installation, RunningGate, message, release_files
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

REPOSITORY = "robotkube/deployment"


@pytest.fixture
def writer(installation: Installation, tmp_path: Path) -> Iterator[NoteWriter]:
    account = ("gate", installation.passwords["gate"])
    forge = GiteaForge(installation.url, REPOSITORY, *account)
    notes = GitNotes(installation.url, REPOSITORY, *account, tmp_path / "notes")
    yield NoteWriter(forge, notes, ["manager"], time.monotonic)
    forge.disconnect()


def merged(installation: Installation, name: str) -> tuple[int, str, str]:
    """Number, commit and plan of a proposal that the gate merged."""
    manager = installation.clone("manager")
    plan = installation.plan()
    commit = manager.commit(release_files(plan, name), message(plan), [manager.tip()])
    number = installation.propose(manager, commit, plan)
    until(lambda: installation.pull_request(number)["merged"], "merged")
    return number, commit, plan


def facts(commit: str, plan: str) -> PlanOutcome:
    seen = ReleaseOutcome("cloud-0/noted", "Synced", "Healthy", ("cloud-0",), ("sha256:" + "1" * 64,))
    return PlanOutcome(plan, commit, 1, 2, 3, (seen,), ())


def say(installation: Installation, account: str, number: int, text: str) -> int:
    return installation.client(account).post(f"/issues/{number}/comments", json={"body": text}).status_code


def note(installation: Installation, commit: str) -> str:
    """The commit's note at the forge; empty when there is none."""
    clone = installation.clone("argocd")
    clone.repository.remotes["origin"].fetch([f"+{REFERENCE}:{REFERENCE}"], callbacks=pygit2.RemoteCallbacks(
        credentials=pygit2.UserPass("argocd", installation.passwords["argocd"])
    ))  # fmt: skip
    try:
        return str(clone.repository.lookup_note(commit, REFERENCE).message)
    except KeyError:
        return ""


def test_closing_words_become_the_note_of_their_commit_once(
    installation: Installation, gate: RunningGate, writer: NoteWriter
) -> None:
    number, commit, plan = merged(installation, "noted")
    outcome = facts(commit, plan)
    assert say(installation, "manager", number, outcome_comment(outcome)) == 201
    writer.commented(number)
    writer.round(resync=False)
    assert note(installation, commit) == note_text(outcome) + "\n"
    assert writer.written == 1
    writer.round(resync=True)  # what other tests have closed before gets its note now
    written = writer.written
    writer.commented(number)
    writer.round(resync=True)
    assert writer.written == written


def test_words_of_others_and_about_other_commits_become_no_note(
    installation: Installation, gate: RunningGate, writer: NoteWriter
) -> None:
    number, commit, plan = merged(installation, "unnoted")
    assert say(installation, "operator-team", number, outcome_comment(facts(commit, plan))) == 201
    assert say(installation, "manager", number, outcome_comment(facts("0" * 40, plan))) == 201
    writer.commented(number)
    writer.round(resync=True)
    assert note(installation, commit) == ""


def test_a_note_that_was_missed_is_found_by_looking(
    installation: Installation, gate: RunningGate, writer: NoteWriter
) -> None:
    number, commit, plan = merged(installation, "missed")
    assert say(installation, "manager", number, outcome_comment(facts(commit, plan))) == 201
    writer.round(resync=True)
    assert '"plan": "' + plan in note(installation, commit)


def test_the_manager_may_not_write_notes(installation: Installation, tmp_path: Path) -> None:
    clone = installation.clone("manager")
    who = pygit2.Signature("manager", "manager@robotkube.invalid")
    tip = clone.tip()
    clone.repository.create_note("mine\n", who, who, tip, REFERENCE, True)
    target = str(clone.repository.references[REFERENCE].target)
    assert clone.push(target, REFERENCE) != ""
