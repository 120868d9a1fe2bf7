"""The gate against a real forge: what it takes, what it refuses and in which words, and what survives restarts."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.deployment.core.releases import TaskCause
from robotkube.foundation.runtime.core.webhook_deliveries import sign
from robotkube.registry.charts.core.references import ChartReference
from tests.stages import http_calls
from tests.stages.attacks import shown
from tests.stages.forge.catalogue_evidence import published_chart
from tests.stages.forge.installation import (
    CATALOGUE,
    CAUSE,
    DIGESTS,
    WEBHOOK_SECRET,
    ApplicationSetController,
    Clone,
    Installation,
    RunningGate,
    manager_secret,
    message,
    release_files,
    start_gate,
)
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain


@pytest.fixture(scope="module")
def manager(installation: Installation) -> Clone:
    return installation.clone("manager")


def merged(installation: Installation, number: int) -> bool:
    return bool(installation.pull_request(number)["merged"])


def decided(gate: RunningGate) -> dict[int, dict[str, Any]]:
    """The gate's last decisions by pull request."""
    return {decision["pull_request"]: decision for decision in gate.gate.decisions.as_json()["decisions"]}


def checks(decision: dict[str, Any]) -> set[str]:
    return {check["check"] for check in decision["checks"]}


def wait_for_refusal(installation: Installation, number: int) -> str:
    """The comments of a pull request that the gate closed without merging."""
    until(lambda: installation.pull_request(number)["state"] == "closed", "closed")
    assert not merged(installation, number)
    return installation.comments(number)


def test_a_good_proposal_becomes_main_and_is_announced(
    installation: Installation, gate: RunningGate, controller: ApplicationSetController, manager: Clone
) -> None:
    plan = installation.plan()
    before = manager.tip()
    commit = manager.commit(release_files(plan), message(plan), [before])
    number = installation.propose(manager, commit, plan)
    until(lambda: merged(installation, number), "merged")
    pull = installation.pull_request(number)
    assert manager.tip() == commit
    assert pull["merge_commit_sha"] == commit
    assert pull["merged_by"]["login"] == "gate"
    until(lambda: controller.announced(commit), "announced")
    until(lambda: number in decided(gate), "told")
    decision = decided(gate)[number]
    assert (decision["verdict"], decision["way"], decision["commit"]) == ("accepted", "automatic", commit)
    assert {"images are those that the evidence covers", "its message names what it changes"} <= checks(decision)
    assert not [problem for check in decision["checks"] for problem in check["problems"]]
    assert sum(check["seconds"] for check in decision["checks"]) < decision["seconds"]
    event = next(event for _, event in controller.accepted if event["after"] == commit)
    assert event["before"] == before
    assert event["ref"] == "refs/heads/main"
    assert event["repository"] == {
        "html_url": f"{installation.url}/robotkube/deployment",
        "default_branch": "main",
    }


def test_a_proposal_that_main_has_overtaken_is_closed_as_stale(
    installation: Installation, gate: RunningGate, manager: Clone
) -> None:
    old = manager.tip()
    first, second = installation.plan(), installation.plan()
    one = manager.commit(release_files(first, "one"), message(first), [old])
    two = manager.commit(release_files(second, "two"), message(second), [old])
    number = installation.propose(manager, one, first)
    until(lambda: merged(installation, number), "first merged")
    stale = installation.propose(manager, two, second)
    text = wait_for_refusal(installation, stale)
    assert "main moved" in text
    assert old[:12] in text
    assert one[:12] in text
    assert manager.tip() == one


WRONG_FILES = {
    "a file that is not a release": ({"README.md": "mine\n"}, "README.md: a plan may only touch releases/"),
    "a policy": ({"policies/initial.yaml": "add: [{}]\n"}, "policies/initial.yaml: policies are made by people"),
    "what installs": ({"bootstrap/appproject.yaml": "a: 1\n"}, "what installs the platform is changed by people"),
    "a workflow": ({".gitea/workflows/x.yaml": "on: push\n"}, "a forge runs what this file says"),
    "text that is not YAML": ({"releases/cloud-0/broken.yaml": "a: [\n"}, "releases/cloud-0/broken.yaml: not readable"),
    "two documents": ({"releases/cloud-0/two.yaml": "a: 1\n---\nb: 2\n"}, "exactly one YAML document"),
    "an unused source": (
        {path: text for path, text in release_files("", chart="mqtt-bridge", digest=DIGESTS["mqtt-bridge"]).items()
         if path.startswith("sources/")},
        "no release uses this source",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG_FILES)
def test_wrong_files_are_refused(installation: Installation, gate: RunningGate, manager: Clone, case: str) -> None:
    extra, expected = WRONG_FILES[case]
    plan = installation.plan()
    commit = manager.commit({**release_files(plan, "extra"), **extra}, message(plan), [manager.tip()])
    assert expected in wait_for_refusal(installation, installation.propose(manager, commit, plan))


WRONG_RELEASES = {
    "foreign namespace": ({"namespace": "kube-system"}, "'kube-system' is not a namespace that account manager may"),
    "unknown digest": ({"digest": "sha256:" + "a" * 64}, "is not in the catalogue"),
    "withdrawn chart": (
        {"digest": DIGESTS["old"], "version": "0.0.9"},
        "state withdrawn is not allowed (release policy:",
    ),
    "another version": ({"version": "0.3.0"}, "is not in the catalogue, which has"),
    "another plan": ({"plan": "20261121-100000-ffffff"}, "differs from the commit's RobotKube-Plan"),
    "evidence": ({"evidence": "none"}, "robotkube.io/evidence is none, the evidence of chart event-detector@0.2.3@"),
    "values": ({"values": {"placement": {"agent": "cloud-0"}, "x": 1}}, "spec.values: Additional properties are not"),
    "parameters": (
        {"causes": (replace(CAUSE, parameters='{"vehicles":[]}'),)},
        "task cloud-0/pose-1: parameters.vehicles: [] ",
    ),
    "long name": ({"name": "r" * 50}, "at most 53 are allowed"),
    "other trace": (
        {"causes": (TaskCause(CAUSE.task, CAUSE.event, CAUSE.rule, "f" * 32, CAUSE.application, CAUSE.parameters),)},
        "event, rule or trace of",
    ),
}


@pytest.mark.parametrize("case", WRONG_RELEASES)
def test_wrong_releases_are_refused(installation: Installation, gate: RunningGate, manager: Clone, case: str) -> None:
    changes, expected = WRONG_RELEASES[case]
    plan = installation.plan()
    files = release_files(plan, **{"name": "wrong", **changes})
    chart = ChartReference(
        "event-detector", changes.get("version", "0.2.3"), changes.get("digest", DIGESTS["event-detector"])
    )
    commit = manager.commit(files, message(plan, charts=(chart,)), [manager.tip()])
    text = wait_for_refusal(installation, installation.propose(manager, commit, plan))
    assert expected in text
    assert text.startswith(f"Refused {commit[:12]}: the gate does not merge this commit.")


def test_all_problems_are_named_at_once(installation: Installation, gate: RunningGate, manager: Clone) -> None:
    plan = installation.plan()
    files = {**release_files(plan, "many", namespace="kube-system", digest="sha256:" + "b" * 64), "x": "y"}
    commit = manager.commit(files, "deploy everything\n", [manager.tip()])
    text = wait_for_refusal(installation, installation.propose(manager, commit, plan))
    for part in ("x: a plan may only touch", "kube-system", "not in the catalogue", "subject 'deploy everything'"):
        assert part in text
    assert "RobotKube-Plan must stand exactly once" in text


def test_a_link_is_refused(installation: Installation, gate: RunningGate, manager: Clone) -> None:
    plan = installation.plan()
    commit = manager.commit({"releases/cloud-0/link.yaml": "/etc/passwd"}, message(plan), [manager.tip()], 0o120000)
    text = wait_for_refusal(installation, installation.propose(manager, commit, plan))
    assert "releases/cloud-0/link.yaml: not an ordinary text file" in text


def test_a_merge_commit_is_refused(installation: Installation, gate: RunningGate, manager: Clone) -> None:
    plan = installation.plan()
    tip = manager.tip()
    side = manager.commit({"x": "y"}, "side\n", [tip])
    commit = manager.commit(release_files(plan, "merge"), message(plan), [tip, side])
    text = wait_for_refusal(installation, installation.propose(manager, commit, plan))
    assert "has 2 parents" in text


def test_a_foreign_registry_is_refused(installation: Installation, gate: RunningGate, manager: Clone) -> None:
    plan = installation.plan()
    files = {
        path: text.replace("oci://forge", "oci://elsewhere") if text else None
        for path, text in release_files(plan, "foreign", namespace="vehicle-00").items()
    }
    commit = manager.commit(files, message(plan), [manager.tip()])
    assert "must be oci://forge" in wait_for_refusal(installation, installation.propose(manager, commit, plan))


def test_only_what_was_checked_becomes_main(
    installation: Installation, controller: ApplicationSetController, tmp_path: Path, manager: Clone
) -> None:
    """The author proposes anew, under the same topic, after the gate has checked and before it pushes."""
    plan = installation.plan()
    tip = manager.tip()
    good = manager.commit(release_files(plan, "checked"), message(plan), [tip])
    bad = manager.commit({"policies/merge.yaml": "automatic: []\n"}, "mine\n", [tip])
    running = start_gate(installation, controller.url, tmp_path, webhooks=False)
    pushed: list[str] = []

    def propose_anew(commit: str) -> bool:
        if commit == good:
            options = [f"topic={plan}", "title=another", "force-push=true"]
            assert manager.push(bad, "refs/for/main", options) == ""
        pushed.append(commit)
        return push(commit)

    push, running.gate._main.push_main = running.gate._main.push_main, propose_anew  # type: ignore[method-assign]
    try:
        number = installation.propose(manager, good, plan)
        until(lambda: pushed == [good], "checked and pushed")
        text = until_said(installation, number, "Closed, main moved")
        assert manager.tip() == good
        assert "policies/merge.yaml" not in text
    finally:
        running.stop()


def until_said(installation: Installation, number: int, words: str) -> str:
    """The comments of a pull request as soon as they hold `words`."""
    until(lambda: words in installation.comments(number), f"said: {words}")
    return installation.comments(number)


def test_a_forged_status_changes_nothing(
    installation: Installation, controller: ApplicationSetController, tmp_path: Path, manager: Clone
) -> None:
    """Statuses of an account that may write them: that a bad commit passed, and that a good one did not."""
    plans = [installation.plan(), installation.plan()]
    tip = manager.tip()
    bad = manager.commit({"README.md": "mine\n"}, message(plans[0]), [tip])
    good = manager.commit(release_files(plans[1], "in-spite"), message(plans[1]), [tip])
    numbers = [installation.propose(manager, commit, plan) for commit, plan in zip((bad, good), plans, strict=True)]
    for commit, state in ((bad, "success"), (good, "failure")):
        body = {"state": state, "context": "gate", "description": "checked"}
        assert installation.client("operator-team").post(f"/statuses/{commit}", json=body).status_code == 201
        assert installation.client("manager").post(f"/statuses/{commit}", json=body).status_code == 403
    running = start_gate(installation, controller.url, tmp_path)
    try:
        said = wait_for_refusal(installation, numbers[0])
        assert "README.md: a plan may only touch" in said
        shown("gate", said, "status-forged")
        until(lambda: merged(installation, numbers[1]), "merged in spite of a forged failure")
    finally:
        running.stop()


def test_only_the_forge_delivers_to_the_gate(gate: RunningGate) -> None:
    """A manager's secret does not let it name what was proposed, or by whom."""
    pull = {"number": 1, "user": {"login": "manager"}, "head": {"sha": "1" * 40}}
    named = {"action": "closed", "repository": {"full_name": "robotkube/deployment"}, "pull_request": pull}

    def deliver(secret: str) -> int:
        body = json.dumps(named).encode()
        headers = {"X-Gitea-Event": "pull_request", "X-Gitea-Signature": sign(body, secret.encode())}
        return http_calls.post(
            f"http://127.0.0.1:{gate.server.port}/webhook", content=body, headers=headers
        ).status_code

    assert deliver(manager_secret()) == 401
    assert deliver(WEBHOOK_SECRET) == 204


def test_removal_of_a_release_is_taken(installation: Installation, gate: RunningGate, manager: Clone) -> None:
    made, removed = installation.plan(), installation.plan()
    files = release_files(made, "leaving", namespace="vehicle-01")
    first = manager.commit(files, message(made), [manager.tip()])
    wait_for = installation.propose(manager, first, made)
    until(lambda: merged(installation, wait_for), "made")
    gone = manager.commit(dict.fromkeys(files), message(removed, verb="withdraw"), [manager.tip()])
    number = installation.propose(manager, gone, removed)
    until(lambda: merged(installation, number), "removed")


def test_a_new_gate_takes_what_waited_and_leaves_what_is_done(
    installation: Installation, controller: ApplicationSetController, tmp_path: Path, manager: Clone
) -> None:
    """No webhook reaches this one: it only polls. The first proposal waits before it starts."""
    plan = installation.plan()
    commit = manager.commit(release_files(plan, "waiting"), message(plan), [manager.tip()])
    number = installation.propose(manager, commit, plan)
    for folder in ("first", "second"):
        running = start_gate(installation, controller.url, tmp_path / folder, webhooks=False)
        try:
            until(lambda: merged(installation, number), "merged")
            until(lambda: controller.announced(commit), "announced")
        finally:
            running.stop()
        controller.accepted.clear()
        assert installation.comments(number) == ""


def test_the_catalogue_is_read_again_before_a_refusal(
    installation: Installation, controller: ApplicationSetController, tmp_path: Path, manager: Clone
) -> None:
    running = start_gate(installation, controller.url, tmp_path, webhooks=False)
    try:
        until(lambda: not running.gate.reasons_not_ready(), "ready")
        digest = "sha256:" + "c" * 64
        evidence = installation.publish(published_chart("event-detector", "0.3.0", digest))
        plan = installation.plan()
        changes = {"version": "0.3.0", "digest": digest, "namespace": "vehicle-00", "evidence": evidence}
        files = release_files(plan, "newer", **changes)
        text = message(plan, charts=(ChartReference("event-detector", "0.3.0", digest),), evidence=(evidence,))
        number = installation.propose(manager, manager.commit(files, text, [manager.tip()]), plan)
        until(lambda: merged(installation, number), "merged")
    finally:
        running.stop()


def test_what_the_catalogue_withdrew_is_refused_when_both_are_told_at_once(
    installation: Installation, gate: RunningGate, manager: Clone
) -> None:
    """The gate is busy while a version is withdrawn and a plan with it proposed; it reads the catalogue first."""
    pause(gate)
    path = "charts/event-detector/0.2.3.yaml"
    plan = installation.plan()
    number = installation.propose(
        manager, manager.commit(release_files(plan, "late"), message(plan), [manager.tip()]), plan
    )
    head = installation.pull_request(number)["head"]["sha"]
    installation.publish({path: CATALOGUE[path].replace("state: verified", "state: withdrawn")})
    try:
        gate.gate.wake("push", {"repository": {"full_name": "robotkube/catalogue"}})
        wake(gate, number, head)
        assert gate.gate.answer_hints() == 1
        shown("gate", installation.comments(number), "withdrawn-version")
        assert installation.pull_request(number)["state"] == "closed"
        assert not merged(installation, number)
    finally:
        installation.publish({path: CATALOGUE[path]})


@pytest.mark.parametrize("instead", ["nothing", "another commit"])
def test_what_is_not_proposed_any_more_is_not_merged(
    installation: Installation, gate: RunningGate, manager: Clone, instead: str
) -> None:
    """The delivery that names a pull request comes when it is closed, or has another head."""
    pause(gate)
    plan = installation.plan()
    before = manager.tip()
    first, second = (manager.commit(release_files(plan, name), message(plan), [before]) for name in ("one", "two"))
    number = installation.propose(manager, first, plan)
    if instead == "nothing":
        installation.close(number)
    else:
        assert manager.push(second, "refs/for/main", [f"topic={plan}", "force-push=true"]) == ""
    wake(gate, number, first)
    assert gate.gate.answer_hints() == 1
    assert manager.tip() == before
    gate.gate.round()
    assert manager.tip() == (before if instead == "nothing" else second)


def pause(gate: RunningGate) -> None:
    """No thread of the gate runs any more, and no delivery reaches it: rounds are up to the test."""
    gate.gate.stop(gate.stopping)
    gate.thread.join(20)
    gate.server.stop()


def wake(gate: RunningGate, number: int, head: str) -> None:
    """What the forge delivers when a manager proposes a commit."""
    opened = {"number": number, "user": {"login": "manager"}, "head": {"sha": head}}
    repository = {"full_name": "robotkube/deployment"}
    gate.gate.wake("pull_request", {"repository": repository, "action": "opened", "pull_request": opened})


def test_a_hook_that_nobody_took_is_sent_again(installation: Installation, tmp_path: Path, manager: Clone) -> None:
    controller = ApplicationSetController()
    url = controller.url
    controller.stop()
    running = start_gate(installation, url, tmp_path)
    try:
        until(lambda: running.gate.statistics.hooks["lost"] >= 2, "sent again after a failure")
    finally:
        running.stop()
    assert running.gate.statistics.hooks["received"] == 0
