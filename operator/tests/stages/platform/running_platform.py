"""The platform on the shared cluster as the tests see it: as administrator, by kubectl, and by the accounts it made."""

from __future__ import annotations

import functools
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest

from ci.cluster.choosing import Choice
from ci.cluster.embedded import cleaning
from ci.cluster.embedded.network.addresses import plan_of
from ci.cluster.embedded.provider import Embedded
from ci.errors import SetUpError
from ci.folders import PROJECT
from ci.installation import Installer
from ci.steps import Steps
from robotkube.foundation.forge.adapters.git import GitClone, ProposalWriter
from scenarios import definition, demo
from scenarios.definition import Scenario
from scenarios.runner.platform.access import GATE, PLATFORM, Access
from scenarios.runner.waiting import RunError
from tests.stages import http_calls
from tests.stages.paths import WIDEST

NAME = "test"
VARIANT = "small"
SCENARIO = PROJECT / "scenarios" / "pose-point-cloud-db-recording"
STEPS = 6
NODE_LOST_SECONDS = 10  # instead of 40: a story that loses a node waits for it
# Tests ask the suite-runner as the gate does, and they are the machine.
MACHINE = {"from": [{"ipBlock": {"cidr": f"{plan_of(NAME).gateway}/32"}}], "ports": [{"port": 8080}]}
VALUES = {
    "managers": [{"name": "manager", "nodeLostSeconds": NODE_LOST_SECONDS}],
    "networkPolicies": {"extraIngress": {"suite-runner": [MACHINE]}},
}
DEPLOYMENT = "robotkube/deployment"
WAIT_SECONDS_MAX = 60.0
POLL_SECONDS = 0.5


def spoken(config: pytest.Config) -> AbstractContextManager[None]:
    """What is said inside is seen at once: bringing up takes minutes."""
    capture = config.pluginmanager.getplugin("capturemanager")
    quiet: AbstractContextManager[None] = capture.global_and_fixture_disabled()
    return quiet


def eventually(
    what: str, reached: Callable[[], Any], seconds: float = WAIT_SECONDS_MAX, state: Callable[[], object] = lambda: ""
) -> Any:
    """The first true answer; a poll that fails is repeated. Fails with `what` and the last answer, or the last poll's
    failure, after the bound, and with the `state` as it is then."""
    end = time.monotonic() + seconds
    last = None
    while time.monotonic() < end:
        try:
            if last := reached():
                return last
        except (SetUpError, RunError) as error:
            last = error
        time.sleep(POLL_SECONDS)
    raise AssertionError(f"not within {seconds:.0f} s: {what}; last seen: {last!r} {state()}")


@dataclass(frozen=True)
class Platform:
    """The installed platform. `access` is the connection that the scenario's runner uses, too."""

    installer: Installer
    provider: Embedded
    access: Access
    scenario: Scenario

    @property
    def name(self) -> str:
        """Name of the cluster."""
        return self.provider.name

    @property
    def agents(self) -> list[str]:
        """Agents with a release namespace."""
        return [node.agent for node in self.scenario.nodes if node.role != "platform"]

    def kubectl(self, *arguments: str, text: str | None = None, seconds: int = 90) -> str:
        """Standard output of kubectl; SetUpError with what it said when it fails."""
        return self.installer.kubectl(*arguments, text=text, seconds=seconds)

    def get(self, *arguments: str) -> Any:
        """An object or a list as kubectl prints it in JSON."""
        return json.loads(self.kubectl("get", *arguments, "-o", "json"))

    def deployment(self, namespace: str, name: str) -> dict[str, Any]:
        """A Deployment, empty when there is none."""
        text = self.kubectl("-n", namespace, "get", "deployment", name, "--ignore-not-found", "-o", "json")
        return dict(json.loads(text)) if text else {}

    def available(self, namespace: str, name: str) -> bool:
        """Return whether all replicas of a Deployment are there, as last asked for."""
        deployment = self.deployment(namespace, name)
        status = deployment.get("status", {})
        seen = status.get("observedGeneration") == deployment.get("metadata", {}).get("generation")
        return bool(deployment) and seen and status.get("availableReplicas", 0) == deployment["spec"]["replicas"] > 0

    def settled(self) -> bool:
        """Return whether everything that main asks for runs: Applications Synced and Healthy."""
        states = [application.get("status", {}) for application in self.access.applications().values()]
        seen = [(s.get("sync", {}).get("status"), s.get("health", {}).get("status")) for s in states]
        return bool(seen) and all(state == ("Synced", "Healthy") for state in seen)

    def forge_url(self) -> str:
        """Where the forge answers from this machine."""
        return self.access.forge().url

    def password(self, account: str) -> str:
        """A forge account's password."""
        return self.access.secret("robotkube", f"forge-account-{account}")["password"]

    def forge(self, account: str) -> httpx.Client:
        """The forge's API of the deployment repository as `account`; to be closed."""
        base = f"{self.forge_url()}/api/v1/repos/{DEPLOYMENT}"
        return http_calls.client(base_url=base, auth=(account, self.password(account)), timeout=30)

    def writer(self, account: str, folder: Path) -> Writer:
        """Commits to the deployment repository as `account`, by a clone in `folder`."""
        clone = GitClone(self.forge_url(), DEPLOYMENT, account, self.password(account), folder)
        proposals = ProposalWriter(folder, account, self.password(account), account, time.time)
        return Writer(clone, proposals)


@functools.cache
def shared(config: pytest.Config) -> Platform:
    """The one running platform of a test session, brought up by whoever asks first: machines of every role, among them
    those of the small scenario."""
    with spoken(config):
        print(file=sys.stderr)
        request = demo.Request(WIDEST, {}, Choice(NAME), "platform", values=VALUES)
        installer = demo.bring_up(request, Steps(STEPS))
    access = Access(installer.kubeconfig)
    return Platform(installer, Embedded(NAME, installer.binaries), access, definition.load(SCENARIO, [], VARIANT))


def take_down() -> None:
    """Remove the cluster and prove it, unless ROBOTKUBE_KEEP_CLUSTER=1; nothing to do is fine."""
    if os.environ.get("ROBOTKUBE_KEEP_CLUSTER") != "1":
        Embedded(NAME, Path()).down()
        assert cleaning.leftovers(NAME) == ()


def stop_demo(config: pytest.Config) -> None:
    """Stop a demo that runs, and say so."""
    if cleaning.leftovers("demo"):
        with spoken(config):
            print("\nstopping the cluster demo: only one can run at a time", file=sys.stderr, flush=True)
            Embedded("demo", Path()).down()


@contextmanager
def asleep(platform: Platform, component: str) -> Iterator[None]:
    """A Deployment of the platform does not run meanwhile; afterwards it does, even if somebody woke it before."""
    namespace = GATE if component == "gate" else PLATFORM
    platform.kubectl("-n", namespace, "scale", f"deployment/{component}", "--replicas=0")
    chosen = ("-n", namespace, "wait", "--for=delete", "pod", "-l", f"app.kubernetes.io/name={component}")
    platform.kubectl(*chosen, "--timeout=30s")
    try:
        yield
    finally:
        platform.kubectl("-n", namespace, "scale", f"deployment/{component}", "--replicas=1")
        platform.kubectl("-n", namespace, "rollout", "status", f"deployment/{component}", "--timeout=60s")


@dataclass(frozen=True)
class Writer:
    """One account with a clone of the deployment repository."""

    clone: GitClone
    proposals: ProposalWriter

    def commit(self, changes: Mapping[str, str | None], message: str) -> str:
        """A commit on main's tip."""
        return self.proposals.commit(self.clone.fetch(), changes, message)

    def push(self, changes: Mapping[str, str | None], message: str) -> str:
        """The changes on main, by the account itself: no pull request, no gate."""
        end = time.monotonic() + WAIT_SECONDS_MAX
        while time.monotonic() < end:  # as long as plans are merged meanwhile
            commit = self.commit(changes, message)
            if self.clone.push_main(commit):
                return commit
        raise AssertionError(f"main has moved at each push for {WAIT_SECONDS_MAX:.0f} s")
