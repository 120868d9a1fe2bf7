"""What the gate merges is recorded at a real forge, by the gate alone, and an audit finds it there and in what it
saved."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pygit2
import pytest

from robotkube.cli.main import main
from robotkube.delivery.deployment.core.merge_records import REFERENCE, MergeRecord, read_record
from robotkube.delivery.gate.adapters.merge_journal import FileJournal
from robotkube.delivery.gate.loops.merge_records import MergeRecorder
from robotkube.errors import UnavailableError
from robotkube.foundation.documents.core.times import time_text
from robotkube.foundation.forge.adapters.git import GitClone, GitNotes
from tests.stages.forge.catalogue_evidence import gate_key, key_folder, trusted_keys
from tests.stages.forge.installation import (
    ApplicationSetController,
    Installation,
    RunningGate,
    message,
    release_files,
    start_gate,
)
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

REPOSITORY = "robotkube/deployment"


@pytest.fixture
def recorder(installation: Installation, tmp_path: Path) -> MergeRecorder:
    forge = (installation.url, REPOSITORY, "gate", installation.passwords["gate"], tmp_path / "records")
    return MergeRecorder(
        GitNotes(*forge, REFERENCE),
        GitClone(*forge),
        FileJournal(tmp_path / "merges"),
        gate_key(),
        f"{installation.url}/{REPOSITORY}",
        "robotkube-gate",
        lambda: time_text(time.time_ns()),
    )


@pytest.fixture
def gate(
    installation: Installation, controller: ApplicationSetController, recorder: MergeRecorder, tmp_path: Path
) -> Iterator[RunningGate]:
    running = start_gate(installation, controller.url, tmp_path, recorder=recorder)
    yield running
    running.stop()


def records(installation: Installation, commit: str) -> MergeRecord:
    """The record of a commit at the forge, its signature verified."""
    clone = installation.clone("argocd")
    account = pygit2.UserPass("argocd", installation.passwords["argocd"])
    reader = pygit2.RemoteCallbacks(credentials=account)
    clone.repository.remotes["origin"].fetch([f"+{REFERENCE}:{REFERENCE}"], callbacks=reader)
    text = str(clone.repository.lookup_note(commit, REFERENCE).message)
    return read_record(trusted_keys().verify(text.removesuffix("\n").encode()))


def test_a_record_names_who_approved(installation: Installation, gate: RunningGate, recorder: MergeRecorder) -> None:
    person = installation.clone("operator-team")
    before = person.tip()
    policy = "add: []\nremove: []\n# seen by two\n"
    commit = person.commit({"policies/initial.yaml": policy}, "Say something\n", [before])
    number = installation.propose(person, commit, installation.plan())
    until(lambda: f"Checked {commit[:12]}" in installation.comments(number), "checked")
    review = {"event": "APPROVED", "commit_id": commit, "body": "seen"}
    installation.client("reviewer").post(f"/pulls/{number}/reviews", json=review).raise_for_status()
    until(lambda: installation.pull_request(number)["merged"], "merged")
    recorder.round()
    record = records(installation, person.tip())
    assert (record.author, record.way, record.approvals) == ("operator-team", "approval", ("reviewer",))
    assert (record.previous, record.pull_request) == (before, str(number))


def test_a_merge_whose_push_got_no_answer_is_recorded(
    installation: Installation, gate: RunningGate, recorder: MergeRecorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    push = gate.gate._main.push_main

    def unanswered(commit: str) -> bool:
        monkeypatch.undo()
        push(commit)
        raise UnavailableError("push: the connection was lost")

    monkeypatch.setattr(gate.gate._main, "push_main", unanswered)
    manager = installation.clone("manager")
    plan = installation.plan()
    commit = manager.commit(release_files(plan, "unanswered"), message(plan), [manager.tip()])
    number = installation.propose(manager, commit, plan)
    until(lambda: installation.pull_request(number)["merged"], "merged")
    until(lambda: not recorder._under_way, "the gate noticed")
    recorder.round()
    assert records(installation, commit).author == "manager"


class Audit:
    """Runs the command."""

    def __init__(self, installation: Installation, folder: Path, capture: pytest.CaptureFixture[str]) -> None:
        password = folder / "password"
        password.write_text(f"{installation.passwords['manager']}\n")
        self.forge = ("--forge-url", installation.url, "--password-file", str(password))
        self._capture = capture

    def run(self, *words: str) -> tuple[int, dict[str, Any]]:
        """Exit code and document."""
        code = main(["audit", *words, "--keys", str(key_folder()), "--output", "json"])
        out, err = self._capture.readouterr()
        return code, json.loads(out) if out else {"words": err}


def test_a_merged_plan_has_a_record_that_an_audit_verifies(
    installation: Installation,
    gate: RunningGate,
    recorder: MergeRecorder,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    manager = installation.clone("manager")
    plan = installation.plan()
    commit = manager.commit(release_files(plan, "audited"), message(plan), [manager.tip()])
    number = installation.propose(manager, commit, plan)
    until(lambda: installation.pull_request(number)["merged"], "merged")
    recorder.round()
    assert recorder.written == 1
    assert manager.push(commit, REFERENCE, force=True), "records are written by the gate alone"

    audit = Audit(installation, tmp_path, capsys)
    saved = tmp_path / "saved"
    code, document = audit.run("cloud-0/audited", *audit.forge, "--save", str(saved))
    assert code == 1, "no chart of these tests stands in the registry"
    (change,) = document["changes"]
    assert change["checked"] == {
        "approved_by": [],
        "at": change["time"],
        "author": "manager",
        "catalogue": document["as_of"]["catalogue"]["tip"],
        "key": gate_key().key_id,
        "pull_request": str(number),
        "way": "automatic",
    }
    concerns = {one["finding"] for one in document["findings"] if one["concerns"]}
    assert concerns == {"chart-missing", "tag-moved"}

    _, offline = audit.run("cloud-0/audited", "--offline", str(saved))
    assert {**offline, "as_of": None} == {**document, "as_of": None}

    _, again = audit.run("cloud-0/audited", *audit.forge, "--save", str(saved))
    assert "main-rewritten" not in {one["finding"] for one in again["findings"]}
