"""`robotkube agent revoke` and `restore` from the command line to the broker: a proposal at a real forge, another
person's approval, the gate's merge, and what the process that keeps rights makes of it."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robotkube.cli.main import main
from robotkube.delivery.deployment.core.policies.revoked import read_revoked
from robotkube.foundation.forge.adapters.git import GitClone
from tests.stages.delivery.rights.kept_rights import KeptRights
from tests.stages.delivery.tasks.mqtt_connection import NOT_AUTHORISED
from tests.stages.forge.installation import Installation, RunningGate
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

ENDED_SECONDS_MAX = 5.0


@pytest.fixture
def rights(installation: Installation, tmp_path: Path) -> Iterator[KeptRights]:
    account = ("operator-team", installation.passwords["operator-team"])
    clone = GitClone(installation.url, "robotkube/deployment", *account, tmp_path / "main")
    made = KeptRights(tmp_path / "broker", clone)
    made.ready()
    yield made
    for connection in made.made:
        connection.close()
    made.end()
    made.broker.stop()


class Person:
    """Who proposes on the command line, and who approves."""

    def __init__(self, installation: Installation, folder: Path) -> None:
        self.installation = installation
        self.file = folder / "password"
        self.file.write_text(installation.passwords["operator-team"])

    def words(self, *words: str) -> list[str]:
        return ["agent", *words, "--forge-url", self.installation.url, "--password-file", str(self.file), "-o", "json"]

    def merged(self, proposal: dict[str, Any]) -> None:
        """Another person approves it, and the gate merges it."""
        number = int(str(proposal["pull_request"]).rpartition("/")[2])
        until(lambda: "nothing speaks against it" in self.installation.comments(number), "checked")
        body = {"event": "APPROVED", "commit_id": self.installation.pull_request(number)["head"]["sha"], "body": "seen"}
        self.installation.client("reviewer").post(f"/pulls/{number}/reviews", json=body).raise_for_status()
        until(lambda: self.installation.pull_request(number)["merged"], "merged")


def test_from_the_command_to_the_broker(
    installation: Installation,
    gate: RunningGate,
    rights: KeptRights,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    person = Person(installation, tmp_path)
    vehicle, other = rights.connect("vehicle-00"), rights.connect("vehicle-01")
    revoke = person.words("revoke", "vehicle-00", "--reason", "its computer was stolen")
    assert main([*revoke, "--dry-run"]) == 0
    proposed = json.loads(capsys.readouterr().out)
    assert (proposed["pull_request"], read_revoked(proposed["file"])) == ("", {"vehicle-00": "its computer was stolen"})
    assert main(revoke) == 0
    person.merged(json.loads(capsys.readouterr().out))
    begun = time.monotonic()
    rights.follower.wake()
    until(lambda: vehicle.lost, "its connection ends")
    assert time.monotonic() - begun < ENDED_SECONDS_MAX
    assert rights.connect("vehicle-00").refused == NOT_AUTHORISED
    assert not other.lost
    assert main(revoke) == 1
    assert "vehicle-00 is revoked already: its computer was stolen" in capsys.readouterr().err
    assert main(person.words("restore", "vehicle-00")) == 0
    person.merged(json.loads(capsys.readouterr().out))
    rights.follower.wake()
    until(lambda: rights.connect("vehicle-00").refused is None, "it is let in")


def test_what_cannot_be_proposed(
    installation: Installation, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    person = Person(installation, tmp_path)
    assert main(person.words("restore", "vehicle-01")) == 1
    assert "vehicle-01 is not revoked; on main are: none" in capsys.readouterr().err
    assert main(person.words("revoke", "vehicle-01", "--reason", "two\nlines")) == 2
    assert "revoked[0].reason: must be one line of 1 to 200 characters" in capsys.readouterr().err
