"""Two processes of one manager on a real Lease: the second takes over in time, and the first can write nothing then."""

import contextlib
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.deployment.core.commit_messages import read_message
from robotkube.foundation.forge.adapters.push_hooks import PushRelay
from tests.stages import http_calls
from tests.stages.delivery.manager.manager_process import Pod, conditions, write_settings
from tests.stages.forge.installation import (
    ApplicationSetController,
    Installation,
    RunningGate,
    message,
    outside,
    start_gate,
)
from tests.stages.kubernetes.api_calls import LEASE_LABELS, LEASES, TASKS, Api
from tests.stages.programs import free_port
from tests.stages.waiting import until

pytestmark = [pytest.mark.toolchain, pytest.mark.thorough]
TAKE_OVER_SECONDS_MAX = 15.0
TERM_OF_MAIN = 41
GRACE = 1.0  # seconds that observing itself may take
PROPOSE = "robotkube.foundation.forge.adapters.git.proposals.ProposalWriter.propose"
MEETING = {"application": "pose-point-cloud-recording", "parameters": {"vehicles": ["vehicle-00", "vehicle-01"]}}


@pytest.fixture
def own_gate(
    own_installation: Installation, controller: ApplicationSetController, tmp_path: Path
) -> Iterator[RunningGate]:
    running = start_gate(own_installation, controller.url, tmp_path / "gate")
    until(lambda: not running.gate.reasons_not_ready(), "gate ready")
    yield running
    running.stop()


class Replicas:
    """Pods of one manager, on one Lease."""

    def __init__(self, installation: Installation, manager_api: Api, folder: Path) -> None:
        self.installation, self.api, self.folder = installation, manager_api, folder
        self.lease = manager_api.lease()
        self.pods: list[Pod] = []

    def start(self, point: str = "") -> Pod:
        port = free_port()
        folder = self.folder / f"pod-{len(self.pods)}"
        folder.mkdir()
        config = write_settings(outside(self.installation), folder, port, self.lease)
        pod = Pod(config, self.api.kubeconfig, port, folder.name, point)
        self.pods.append(pod)
        return pod

    def start_both(self) -> tuple[Pod, Pod]:
        """One that leads, and a second that waits."""
        first = self.start()
        until(lambda: self.settled(first), "the first leads", 40)
        second = self.start()
        until(second.ready, "the second waits")
        return first, second

    def spec(self) -> dict[str, Any]:
        return dict(self.api.get(f"{LEASES}/{self.lease}").get("spec") or {})

    def term(self) -> int:
        return int(self.spec().get("leaseTransitions", 0))

    def leads(self, pod: Pod) -> bool:
        """It leads, and is ready to."""
        address = pod.url.removeprefix("http://")
        return bool(self.spec().get("holderIdentity") == f"{pod.log.parent.name}_{address}" and pod.ready())

    def settled(self, pod: Pod) -> bool:
        """It leads, and has written what was to be written before the test began."""
        return self.leads(pod) and all(plan["on_main"] or plan["error"] for plan in pod.plans())

    def stop(self) -> None:
        for pod in self.pods:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pod.process.pid, signal.SIGCONT)
            pod.kill()


@pytest.fixture
def replicas(
    own_installation: Installation, own_gate: RunningGate, manager_api: Api, tmp_path: Path
) -> Iterator[Replicas]:
    started = Replicas(own_installation, manager_api, tmp_path)
    yield started
    started.stop()
    for item in manager_api.get(TASKS)["items"]:
        manager_api.delete(f"{TASKS}/{item['metadata']['name']}")


def committed(manager_api: Api, name: str) -> bool:
    return conditions(manager_api.get(f"{TASKS}/{name}")).get("Committed") == ("True", "Merged")


def delivered(pod: Pod, secret: str) -> bool:
    """Return whether a push event, as the gate sends it, is taken."""
    relay = PushRelay(f"{pod.url}/webhook", secret.encode(), "robotkube/deployment")
    try:
        return relay.hook("0" * 40, "1" * 40)
    finally:
        relay.disconnect()


def terms_on_main(installation: Installation, task: str) -> list[int]:
    """Terms of the plans that name a task, oldest first."""
    clone = installation.clone("argocd")
    at = clone.repository[clone.tip()]
    terms = []
    while at is not None:
        if f"RobotKube-Task: {task}\n" in at.message:
            terms.append(read_message(at.message).term)
        at = at.parents[0] if at.parents else None
    return terms[::-1]


def test_a_leader_that_stood_still_before_its_push_is_refused_afterwards(
    own_installation: Installation, replicas: Replicas, manager_api: Api
) -> None:
    first = replicas.start(f"stop before {PROPOSE}")
    until(lambda: first.hit, "the first leader stands before a push", 40)
    term = replicas.term()
    second = replicas.start()
    until(lambda: replicas.settled(second), "the second leads", 40)
    manager_api.task("meeting", **MEETING)
    until(lambda: committed(manager_api, "meeting"), "the second writes main", 40)
    assert replicas.term() == term + 1
    before = own_installation.clone("argocd").tip()
    os.kill(first.process.pid, signal.SIGCONT)
    pulls = own_installation.client("gate")

    def refused() -> list[str]:
        closed = pulls.get("/pulls", params={"state": "closed", "poster": "manager", "limit": 50}).json()
        unmerged = [int(item["number"]) for item in closed if not item["merged"]]
        return [own_installation.comments(number) for number in unmerged]

    until(refused, "the first one's proposal is refused")
    text = "\n".join(refused())
    assert f"RobotKube-Term: {term} is lower than {term + 1}, manager's last on main" in text
    assert own_installation.clone("argocd").tip() == before
    assert terms_on_main(own_installation, "cloud-0/meeting") == [term + 1]
    until(lambda: first.plans() == second.plans(), "the first knows that it does not lead, and asks the second")
    assert replicas.leads(second)


def test_the_second_takes_over_in_time_and_goes_on(
    own_installation: Installation, replicas: Replicas, manager_api: Api
) -> None:
    first, second = replicas.start_both()
    assert replicas.leads(first)
    manager_api.task("before", **MEETING)
    until(lambda: committed(manager_api, "before"), "committed by the first")
    term = replicas.term()
    os.kill(first.process.pid, signal.SIGSTOP)
    stood = time.monotonic()
    until(lambda: replicas.leads(second), "the second leads", TAKE_OVER_SECONDS_MAX + GRACE)
    assert time.monotonic() - stood < TAKE_OVER_SECONDS_MAX
    assert replicas.term() == term + 1
    manager_api.delete(f"{TASKS}/before")
    until(lambda: second.plans() and second.plans()[-1]["cause"] == "withdrawal", "the second withdraws")
    until(lambda: second.plans()[-1]["on_main"], "on main")
    assert terms_on_main(own_installation, "cloud-0/before") == [term, term + 1]


def test_a_leader_that_ends_gives_its_lease_back(replicas: Replicas) -> None:
    first, second = replicas.start_both()
    assert first.end() == 0
    until(lambda: replicas.leads(second), "the second leads at once", 5)
    assert replicas.api.get(f"{LEASES}/{replicas.lease}")["metadata"]["labels"] == LEASE_LABELS


def test_what_reaches_the_one_that_waits_is_answered_by_the_leader(
    own_installation: Installation, replicas: Replicas, manager_api: Api
) -> None:
    first, second = replicas.start_both()
    manager_api.task("asked", **MEETING)
    until(lambda: committed(manager_api, "asked"), "committed by the first")
    until(lambda: second.plans() == first.plans(), "the second shows the plans of the first")
    assert first.plans()[-1]["tasks"] == ["cloud-0/asked"]
    answer = http_calls.post(f"{second.url}/explain", json={"task": "cloud-0/asked"}, timeout=10)
    assert (answer.status_code, answer.json()["outcome"]) == (200, "Accepted")
    assert delivered(second, outside(own_installation).webhook_secret)
    assert not delivered(second, "another secret")
    assert replicas.leads(first)


def test_a_new_lease_does_not_fall_behind_main(
    own_installation: Installation, replicas: Replicas, manager_api: Api
) -> None:
    """As in a new cluster on a repository that stayed: the Lease counts from the beginning, main has a higher term."""
    gate = own_installation.clone("gate")
    text = message(own_installation.plan(), term=TERM_OF_MAIN)
    assert gate.push(gate.commit({"README.md": "as before\n"}, text, [gate.tip()]), "refs/heads/main") == ""
    assert replicas.term() == 0
    manager_api.task("again", **MEETING)
    pod = replicas.start()
    until(lambda: committed(manager_api, "again"), "committed under a higher term", 60)
    assert terms_on_main(own_installation, "cloud-0/again")[-1] == replicas.term() > TERM_OF_MAIN
    assert replicas.leads(pod)
