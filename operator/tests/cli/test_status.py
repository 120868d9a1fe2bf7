"""The command `robotkube status` on real repositories: what the gate did not check, each kind in words of its own."""

from __future__ import annotations

import json
from typing import Any

import pytest

from robotkube.cli import status
from robotkube.cli.forge_access import AccountAtForge
from robotkube.cli.main import main
from robotkube.delivery.deployment.core.break_glass import ACCEPTED_PATH
from robotkube.delivery.deployment.core.merge_records import REFERENCE
from robotkube.registry.evidence.adapters.dsse import TrustedKeys
from tests.stages.attacks import shown
from tests.stages.delivery.audit.audited_platform import Platform
from tests.stages.delivery.audit.manipulations import (
    LATER,
    all_records_removed,
    break_glass,
    break_glass_by_people_whom_nobody_checked,
    break_glass_that_nobody_signed,
    commit_past_the_gate,
    commit_with_a_record_of_a_stranger,
)


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody writes records here."""
    monkeypatch.setattr(status, "RECORD_SECONDS_MAX", 0.0)


class Status:
    def __init__(self, platform: Platform, capture: pytest.CaptureFixture[str]) -> None:
        self.platform = platform
        self._capture = capture

    def run(self, *words: str) -> tuple[int, str, str]:
        password = self.platform.folder / "password"
        password.write_text("x")
        forge = ("--forge-url", str(self.platform.folder / "forge"), "--password-file", str(password))
        code = main(["status", *forge, "--keys", str(self.platform.folder / "keys"), *words])
        out, err = self._capture.readouterr()
        return code, out, err

    def rows(self) -> list[dict[str, Any]]:
        return list(json.loads(self.run("-o", "json")[1])["unchecked"])


@pytest.fixture
def asked(platform: Platform, capsys: pytest.CaptureFixture[str]) -> Status:
    return Status(platform, capsys)


def test_a_platform_that_the_gate_alone_moved(asked: Status) -> None:
    code, out, err = asked.run()
    assert (code, err) == (0, "")
    tip = asked.platform.deployment.tip[:12]
    assert out == (
        f"main of robotkube/deployment is at {tip}; everything on it was checked by the gate, or has been replaced or "
        "accepted\n"
    )


def test_each_kind_has_words_of_its_own(asked: Status) -> None:
    break_glass(asked.platform)
    signed = asked.platform.deployment.tip
    asked.platform.deployment.commit({"releases/x.yaml": "1"}, "deploy(recording): as a plan is\n", LATER)
    unrecorded = asked.platform.deployment.tip
    message = "let it through\n\nRobotKube-Break-Glass: 2026-11-18T12:06:40Z\nRobotKube-Signed-By: ada AAAA\n"
    asked.platform.deployment.commit({"README.md": "2"}, message, LATER, "ada")
    claimed = asked.platform.deployment.tip
    code, out, err = asked.run()
    assert code == 1
    for words in (
        "1 commit was let past the gate with people's signatures; ",
        "1 commit only says that it is break-glass: its signatures do not hold, so main was moved past gate and hook; ",
        "1 commit has no record of the gate: main was moved past it, or the record was taken away: ",
        "replace the files, or name the commits in policies/accepted-commits, by a pull request",
    ):
        assert words in err
    shown("elsewhere", err, "main-moved-past-the-gate", "break-glass-claimed")
    assert [commit for commit in (claimed, unrecorded, signed) if commit not in out] == []
    rows = asked.rows()
    assert [(row["commit"], row["how"]) for row in rows] == [
        (claimed, "not-signed"),
        (unrecorded, "no-record"),
        (signed, "break-glass"),
    ]
    assert rows[0]["problem"].startswith("what stands there as the signature of ada is not over this commit")
    assert (rows[1]["reason"], rows[1]["signed_by"], rows[1]["problem"]) == ("deploy(recording): as a plan is", [], "")
    assert (rows[2]["signed_by"], rows[2]["reason"]) == (["ada", "grace"], "let it through")
    assert rows[2]["files"] == ["releases/cloud-0/recorder-c.yaml"]


def test_who_copies_the_trailers_is_not_let_through(asked: Status) -> None:
    break_glass_that_nobody_signed(asked.platform)
    break_glass_by_people_whom_nobody_checked(asked.platform)
    assert {row["how"] for row in asked.rows()} == {"not-signed", "no-record"}
    assert "1 commit was let past" not in asked.run()[2]


def test_a_record_that_is_not_the_gates_is_none(asked: Status) -> None:
    commit_with_a_record_of_a_stranger(asked.platform)
    [row] = asked.rows()
    assert row["how"] == "no-record"
    assert "which is not trusted here" in row["problem"]


def test_what_people_accepted_and_the_gate_merged_is_no_news(asked: Status) -> None:
    commit_past_the_gate(asked.platform)
    accepted = {ACCEPTED_PATH: f"{asked.platform.deployment.tip}\n"}
    assert len(asked.rows()) == 1
    asked.platform.merge(accepted, "It was right\n", LATER + 1, "approval", "ada", "grace")
    assert (asked.run()[0], asked.rows()) == (0, [])


def test_a_main_without_any_record_is_not_called_checked(asked: Status) -> None:
    all_records_removed(asked.platform)
    code, out, err = asked.run()
    assert code == 1
    assert "no commit of main has a valid record of the gate: it never signed one (an older gate), or all were" in err
    assert "everything on it was checked" not in out + err


def test_commits_before_the_first_record_are_said_not_to_be_vouched_for(asked: Status) -> None:
    names = asked.platform.names
    asked.platform.deployment.rewrite_notes(REFERENCE, dict.fromkeys((names["bridge"], names["recorder"])))
    code, _, err = asked.run()
    assert code == 1
    assert "the first record says that there were others before it: records of the gate were taken away" in err


def test_a_record_that_follows_its_merge_is_waited_for(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(status, "RECORD_SECONDS_MAX", 15.0)
    commit_past_the_gate(platform)
    now, waits = [0.0], [0]

    def sleep(seconds: float) -> None:
        now[0] += seconds
        waits[0] += 1
        if waits[0] == 3:
            platform.record(platform.deployment.tip, LATER + 1)

    access = AccountAtForge(str(platform.folder / "forge"), "argocd", "x")
    keys = TrustedKeys(platform.folder / "keys")
    watch = status.read_main(access, platform.folder / "one", keys, lambda: now[0], sleep)
    assert (watch.standing, waits) == ((), [3])
    platform.deployment.commit({"README.md": "2"}, "never recorded\n", LATER)
    watch = status.read_main(access, platform.folder / "two", keys, lambda: now[0], sleep)
    assert [one.how for one in watch.standing] == ["no-record"]
    assert waits == [3 + 15]


def test_another_forge_needs_the_keys_that_count(asked: Status, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", "--forge-url", "http://forge.invalid", "--password-file", "/nowhere"]) == 2
    assert "--forge-url needs --keys with the public keys that you trust" in capsys.readouterr().err
