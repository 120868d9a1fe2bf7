"""What the gate merges is recorded at a real forge, by the gate alone, and an audit finds it there and in what it
saved."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robotkube.cli.main import main
from robotkube.delivery.deployment.core.merge_records import REFERENCE
from robotkube.delivery.gate.adapters.merge_journal import FileJournal
from robotkube.delivery.gate.loops.merge_records import MergeRecorder
from robotkube.foundation.documents.core.times import time_text
from robotkube.foundation.forge.adapters.git import GitClone, GitNotes
from tests.stages.forge.catalogue_evidence import gate_key, key_folder
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
    manager, plan = installation.clone("manager"), installation.plan()
    commit = manager.commit(release_files(plan, "audited"), message(plan), [manager.tip()])
    number = installation.propose(manager, commit, plan)
    until(lambda: installation.pull_request(number)["merged"], "merged")
    recorder.round()
    assert recorder.written == 1
    assert manager.push(commit, REFERENCE, force=True), "records are written by the gate alone"

    audit, saved = Audit(installation, tmp_path, capsys), tmp_path / "saved"
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
