"""Who asked for what no task asks for, and what became of what came past the gate."""

from __future__ import annotations

from typing import Any

from robotkube.delivery.deployment.core.break_glass import ACCEPTED_PATH
from robotkube.delivery.deployment.core.policies.initial import PATH
from tests.stages.delivery.audit.audited_platform import (
    APPLICATION,
    BEGAN,
    BRIDGE,
    MINUTE,
    RECORDER,
    RECORDING,
    Platform,
    files_of,
    message_of,
    plan_id,
    release,
)
from tests.stages.delivery.audit.manipulations import break_glass
from tests.stages.registry.submissions import application

LATER = BEGAN + 60 * MINUTE
ON_CLOUDS = "add: [{application: recording, forRole: cloud}]\n"
FASTER = "add: [{application: recording, forRole: cloud, parameters: {rate: 2}}]\n"
PUBLISHED = "publish: application bridging\n\nRobotKube-Pull-Request: 4\nRobotKube-Approved-By: grace\n"


def policy(platform: Platform, text: str, at: int) -> str:
    return platform.merge({PATH: text}, "policies: who records\n", at, "approval", "ada", "grace")


def deploy(platform: Platform, at: int, number: int = 20, **values: object) -> str:
    """A recorder that no task asks for, by a plan of the manager."""
    made = release(RECORDER, platform.names["evidence of recorder"], "cloud-0", "standing", plan_id(number), **values)
    return platform.merge(files_of(made), message_of(made, kinds=("initial",)), at)


def asked(platform: Platform, word: str) -> list[dict[str, Any]]:
    """The rows of the first run."""
    return list(platform.audit(word)["ran"][0]["policies"])


def test_who_asked_by_a_policy_and_who_approved_it(platform: Platform) -> None:
    wanted = policy(platform, ON_CLOUDS, LATER)
    deploy(platform, LATER + MINUTE)
    (row,) = asked(platform, "cloud-0/standing")
    assert (row["application"], row["entry"]) == ("recording", "recording on every agent of role cloud")
    assert (row["repository"], row["path"], row["commit"]) == ("deployment", PATH, wanted)
    assert (row["author"], row["approved_by"], row["pull_request"]) == ("operator-team", ["grace"], "7")
    assert (row["stands"], bool(row["key"]), row["time"]) == (True, True, "2026-11-18T12:06:41Z")
    (change,) = platform.audit("cloud-0/standing")["changes"]
    assert change["policies"] == [row]
    assert asked(platform, "cloud-0/recorder-a") == []  # a task asked for it


def test_who_changed_the_entry_last_counts_and_another_entry_does_not(platform: Platform) -> None:
    policy(platform, ON_CLOUDS, LATER)
    faster = policy(platform, FASTER, LATER + MINUTE)
    deploy(platform, LATER + 2 * MINUTE)
    policy(platform, f"{FASTER}remove: [{{application: recording, agents: [cloud-1]}}]\n", LATER + 3 * MINUTE)
    deploy(platform, LATER + 4 * MINUTE, 21, rate=2)
    runs = platform.audit("cloud-0/standing")["ran"]
    assert [[row["commit"] for row in run["policies"]] for run in runs] == [[faster], [faster]]


def test_who_took_an_entry_away(platform: Platform) -> None:
    policy(platform, ON_CLOUDS, LATER)
    deploy(platform, LATER + MINUTE)
    gone = policy(platform, "add: []\n", LATER + 2 * MINUTE)
    made = release(RECORDER, platform.names["evidence of recorder"], "cloud-0", "standing", plan_id(21))
    files: dict[str, str | None] = {made.path: None}
    end = platform.merge(files, message_of(made, "withdraw", ("initial",)), LATER + 3 * MINUTE)
    change = next(one for one in platform.audit("cloud-0/standing")["changes"] if one["commit"] == end)
    assert [(row["commit"], row["stands"], row["approved_by"]) for row in change["policies"]] == [
        (gone, False, ["grace"])
    ]


def test_who_submitted_and_approved_what_runs_by_itself(platform: Platform) -> None:
    """By the words of the catalogue's commit, which nobody signed; and the audit says that."""
    text = application("bridging", "bridge", initialFor="vehicle")
    commit = platform.catalogue.commit({"applications/bridging.yaml": text}, PUBLISHED, LATER, "publisher")
    made = release(BRIDGE, platform.names["evidence of bridge"], "vehicle-01", "mqtt-bridge", plan_id(20))
    platform.merge(files_of(made), message_of(made, kinds=("initial",)), LATER + MINUTE)
    document = platform.audit("vehicle-01/mqtt-bridge")
    (row,) = document["ran"][0]["policies"]
    assert row["entry"] == "bridging on every agent of role vehicle (initialFor)"
    assert (row["repository"], row["commit"], row["key"]) == ("catalogue", commit, None)
    assert (row["author"], row["approved_by"], row["pull_request"]) == ("publisher", ["grace"], "4")
    assert any("Cannot be proved from Git: who proposed and approved" in text for text in document["cannot_be_told"])


def test_an_older_gate_did_not_write_down_who_submitted(platform: Platform) -> None:
    text = {APPLICATION: RECORDING.replace("provides:", "initialFor: cloud\n  provides:")}
    platform.catalogue.commit(text, "publish: application recording\n", LATER, "gate")
    deploy(platform, LATER + MINUTE)
    document = platform.audit("cloud-0/standing")
    (row,) = document["ran"][0]["policies"]
    assert (row["author"], row["approved_by"]) == ("", [])
    assert any("an older gate published" in text for text in document["cannot_be_told"])


def test_a_policy_that_nobody_checked_has_an_author_and_no_approval(platform: Platform) -> None:
    """What its message says of approvals is anybody's word."""
    platform.deployment.commit({PATH: ON_CLOUDS}, "by hand\n\nRobotKube-Approved-By: grace\n", LATER, "mallory")
    deploy(platform, LATER + MINUTE)
    (row,) = asked(platform, "cloud-0/standing")
    assert (row["author"], row["approved_by"], row["key"]) == ("mallory", [], None)


def made_good(platform: Platform, commit: str) -> Any:
    return next(one for one in platform.audit("")["changes"] if one["commit"] == commit)["made_good"]


def test_who_let_it_past_the_gate_and_what_became_of_it(platform: Platform) -> None:
    break_glass(platform)
    let_through = platform.deployment.tip
    pushed = platform.deployment.commit({"README.md": "by hand\n"}, "by hand\n", LATER + 1, "ada")
    change = next(one for one in platform.audit("")["changes"] if one["commit"] == let_through)
    assert (change["break_glass"], change["signed_by"]) == (True, ["ada", "grace"])
    assert (made_good(platform, let_through), made_good(platform, pushed)) == (None, None)
    platform.deployment.commit({ACCEPTED_PATH: f"{pushed}\n"}, "accepted by nobody\n", LATER + 2, "ada")
    assert made_good(platform, pushed) is None
    people = ("approval", "ada", "grace")
    accepted = platform.merge({ACCEPTED_PATH: f"{let_through}\n"}, "It was right\n", LATER + 3, *people)
    assert made_good(platform, let_through) == {"how": "accepted", "commit": accepted}
    replaced = platform.merge({"README.md": "as agreed\n"}, "say it\n", LATER + 5, *people)
    assert made_good(platform, pushed) == {"how": "replaced", "commit": replaced}
    platform.merge({ACCEPTED_PATH: "# nothing\n"}, "It was not\n", LATER + 7, *people)
    assert made_good(platform, let_through) is None
