"""Objects that a manager hands to the gate besides its push: they save a fetch, and decide nothing."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import httpx
import pytest

from robotkube.delivery.gate.core.proposal_checks import Proposer
from robotkube.foundation.forge.adapters.git.commit_objects import new_objects
from robotkube.foundation.forge.core.commit_objects import CommitObjects, write_objects
from robotkube.foundation.runtime.core.webhook_deliveries import sign
from tests.stages import http_calls
from tests.stages.forge.installation import (
    PROPOSERS,
    WEBHOOK_SECRET,
    ApplicationSetController,
    Clone,
    Installation,
    RunningGate,
    manager_secret,
    message,
    objects_relay,
    release_files,
    start_gate,
)
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

REPOSITORY = "robotkube/deployment"


@pytest.fixture(scope="module")
def manager(installation: Installation) -> Clone:
    return installation.clone("manager")


def objects_of(manager: Clone, commit: str) -> CommitObjects:
    objects = new_objects(manager.repository, manager.repository[commit])
    assert objects is not None
    return objects


def post(gate: RunningGate, body: bytes, secret: str = "", account: str = "manager") -> httpx.Response:
    """As `account`; `secret` is that account's unless it is given."""
    headers = {"X-Gitea-Signature": sign(body, (secret or manager_secret(account)).encode())}
    return http_calls.post(f"http://127.0.0.1:{gate.server.port}/objects/{account}", content=body, headers=headers)


def send(gate: RunningGate, objects: CommitObjects, account: str = "manager") -> None:
    assert post(gate, write_objects(objects, REPOSITORY), account=account).status_code == 200


def a_plan(installation: Installation, manager: Clone, gate: RunningGate, name: str) -> tuple[str, str]:
    """Plan and commit on the main that the gate knows."""
    plan = installation.plan()
    tip = manager.tip()
    until(lambda: gate.gate._main.tip == tip, "main known to the gate")
    return plan, manager.commit(release_files(plan, name), message(plan), [tip])


def decided(installation: Installation, number: int) -> bool:
    """Return whether it was merged; waits for the forge to say so."""
    until(lambda: installation.pull_request(number)["state"] == "closed", "closed")
    return bool(installation.pull_request(number)["merged"])


def test_what_was_sent_is_merged_without_a_fetch(installation: Installation, gate: RunningGate, manager: Clone) -> None:
    plan, commit = a_plan(installation, manager, gate, "sent")
    send(gate, objects_of(manager, commit))
    assert commit not in gate.gate._main._repository, "kept in memory until the forge names it"
    assert decided(installation, installation.propose(manager, commit, plan))
    assert manager.tip() == commit
    until(lambda: gate.gate.statistics.sources == {"sent": 1, "fetched": 0}, "decided on what was sent")
    assert gate.gate.statistics.verdicts["accepted"] == 1


def test_what_the_forge_names_is_judged_and_not_what_was_sent(
    installation: Installation, gate: RunningGate, manager: Clone
) -> None:
    plan, good = a_plan(installation, manager, gate, "not-proposed")
    bad = manager.commit({"README.md": "mine\n"}, message(plan), [manager.tip()])
    send(gate, objects_of(manager, good))
    number = installation.propose(manager, bad, plan)
    assert not decided(installation, number)
    assert "README.md: a plan may only touch" in installation.comments(number)
    assert manager.tip() not in (good, bad)
    until(lambda: gate.gate.statistics.sources == {"sent": 0, "fetched": 1}, "fetched")
    assert good not in gate.gate._main._repository


def test_a_bad_plan_is_fetched_and_refused_in_the_same_words(
    installation: Installation, gate: RunningGate, manager: Clone
) -> None:
    plan, _ = a_plan(installation, manager, gate, "unused")
    bad = manager.commit({"README.md": "mine\n"}, message(plan), [manager.tip()])
    send(gate, objects_of(manager, bad))
    number = installation.propose(manager, bad, plan)
    assert not decided(installation, number)
    assert "README.md: a plan may only touch" in installation.comments(number)
    until(lambda: gate.gate.statistics.sources == {"sent": 0, "fetched": 1}, "fetched")


def test_what_is_missing_is_fetched(installation: Installation, gate: RunningGate, manager: Clone) -> None:
    plan, commit = a_plan(installation, manager, gate, "incomplete")
    whole = objects_of(manager, commit)
    blob = next(one for one in whole.objects if one[0] == "blob")
    send(gate, replace(whole, objects=tuple(one for one in whole.objects if one != blob)))
    assert decided(installation, installation.propose(manager, commit, plan))
    assert manager.tip() == commit
    until(lambda: gate.gate.statistics.sources == {"sent": 0, "fetched": 1}, "fetched")


def test_objects_on_a_main_that_has_moved_give_a_stale_proposal(
    installation: Installation, controller: ApplicationSetController, tmp_path: Path, manager: Clone
) -> None:
    """Main moves past the gate, which learns of that only by a resync."""
    running = start_gate(installation, controller.url, tmp_path, webhooks=False)
    try:
        plan, commit = a_plan(installation, manager, running, "overtaken")
        other = installation.clone("gate")
        moved = other.commit({"policies/note.md": f"{plan}\n"}, "by hand\n", [other.tip()])
        assert other.push(moved, "refs/heads/main") == ""
        running.gate.add_objects("manager", objects_of(manager, commit))
        number = installation.propose(manager, commit, plan)
        assert not decided(installation, number)
        assert "Closed, main moved" in installation.comments(number)
        assert manager.tip() == moved
    finally:
        running.stop()


@pytest.fixture
def two_managers(
    installation: Installation, controller: ApplicationSetController, tmp_path: Path
) -> Iterator[RunningGate]:
    """A gate that knows another manager, `north`, besides the one of these tests."""
    proposers = (*PROPOSERS, Proposer("north", frozenset({"edge-0"})))
    running = start_gate(installation, controller.url, tmp_path, proposers=proposers)
    until(lambda: not running.gate.reasons_not_ready(), "gate ready")
    yield running
    running.stop()


def test_a_manager_sends_for_itself_alone(
    installation: Installation, two_managers: RunningGate, manager: Clone
) -> None:
    gate = two_managers
    plan, commit = a_plan(installation, manager, gate, "for-another")
    objects = objects_of(manager, commit)
    assert post(gate, write_objects(objects, REPOSITORY), manager_secret("north")).status_code == 401
    send(gate, objects, account="north")
    assert decided(installation, installation.propose(manager, commit, plan))
    until(lambda: gate.gate.statistics.sources == {"sent": 0, "fetched": 1}, "fetched")


@pytest.mark.parametrize("secret", ["another", WEBHOOK_SECRET])
def test_only_what_a_manager_signed_is_accepted(
    installation: Installation, gate: RunningGate, manager: Clone, secret: str
) -> None:
    """What is signed for the gate's webhook is as good as not signed."""
    _, commit = a_plan(installation, manager, gate, "unsigned")
    body = write_objects(objects_of(manager, commit), REPOSITORY)
    assert post(gate, body, secret).status_code == 401
    assert post(gate, body, secret, account="nobody").status_code == 404
    assert http_calls.post(f"http://127.0.0.1:{gate.server.port}/objects/manager", content=body).status_code == 401
    answer = post(gate, body.replace(commit.encode(), b"0" * 40))
    assert (answer.status_code, answer.json()) == (
        400,
        {"problems": ["commit: must be the id of one of objects, of kind commit"]},
    )
    assert gate.gate._pending_objects.pop("manager", commit) is None


def test_the_relay_sends_while_the_forge_receives_the_push(
    installation: Installation, gate: RunningGate, manager: Clone
) -> None:
    relay = objects_relay(installation)
    try:
        plan, commit = a_plan(installation, manager, gate, "relayed")
        objects = objects_of(manager, commit)

        def arrived() -> bool:
            relay.send(objects)  # best effort: again when it was lost
            return commit in gate.gate._pending_objects._kept.get("manager", {})

        until(arrived, "objects at the gate")
        assert decided(installation, installation.propose(manager, commit, plan))
    finally:
        relay.disconnect()
    until(lambda: gate.gate.statistics.sources == {"sent": 1, "fetched": 0}, "decided on what was sent")
