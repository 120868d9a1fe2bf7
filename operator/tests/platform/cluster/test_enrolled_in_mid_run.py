"""A vehicle that main enrolls while the others drive takes part in the use case: it meets one of them, and its point
clouds are recorded. Its name was reserved before; nothing of the platform is upgraded, or starts again, meanwhile."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from ci.installation import NAMESPACE
from robotkube.cli.main import main
from scenarios.definition import cloud_topic
from scenarios.generator import bags
from scenarios.runner.platform import proposing
from scenarios.runner.platform.placing import place_bags
from scenarios.runner.playing import driving, policy
from tests.stages.platform.machines import declared, leave, values
from tests.stages.platform.running_platform import Platform, eventually
from tests.stages.platform.table_one import Stage

pytestmark = pytest.mark.thorough

NEW, OTHER = "vehicle-01", "vehicle-00"
DRIVING_MINUTES = 12.0
MET_SECONDS_MAX, PARTED_SECONDS_MAX = 240.0, 120.0
COMMAND_SECONDS_MAX = 120
SETTLED_SECONDS_MAX = 180.0


@contextmanager
def reserved(platform: Platform, tmp_path: Path) -> Iterator[str]:
    """The agent's name is reserved and its machine, whose name is yielded, off; at the end it is one of the values'
    agents again, with it."""
    [machine] = [node.name for node in platform.scenario.nodes if node.agent == NEW]
    with declared(platform, [{"name": NEW, "reserved": True, "claims": claims(platform)}], tmp_path):
        leave(platform, machine)
        try:
            yield machine
        finally:
            if machine not in nodes(platform):
                platform.provider.start_node(machine)
    eventually("its Node is there", lambda: machine in nodes(platform))
    eventually("everything that main asks for runs", platform.settled, SETTLED_SECONDS_MAX)


def nodes(platform: Platform) -> set[str]:
    return {node["metadata"]["name"] for node in platform.get("nodes")["items"]}


def claims(platform: Platform) -> list[Mapping[str, Any]]:
    """The volume claims that the values give the agent."""
    [agent] = [one for one in values(platform)["agents"] if one["name"] == NEW]
    return list(agent.get("claims", ()))


class Person:
    """Who enrolls and withdraws on the command line; another person approves."""

    def __init__(self, platform: Platform, stage: Stage, folder: Path) -> None:
        self.platform, self.stage = platform, stage
        self.password, self.authority = folder / "password", folder / "ca.crt"
        self.password.write_text(platform.password("operator-team"))
        self.authority.write_text(platform.access.configmap(NAMESPACE, "robotkube-ca")["ca.crt"])

    def proposes(self, capsys: pytest.CaptureFixture[str], *words: str) -> None:
        """A proposal by `robotkube agent`, approved and merged."""
        access = ["--forge-url", self.platform.forge_url(), "--forge-ca", str(self.authority)]
        capsys.readouterr()
        assert main(["agent", *words, *access, "--password-file", str(self.password), "-o", "json"]) == 0
        number = int(json.loads(capsys.readouterr().out)["pull_request"].rpartition("/")[2])
        deployment = self.stage.deployment
        eventually("the gate has checked it", lambda: "nothing speaks against it" in deployment.comments(number))
        with self.platform.forge("reviewer") as forge:
            head = forge.get(f"/pulls/{number}").raise_for_status().json()["head"]["sha"]
        deployment.approve(number, head)
        eventually("it is merged", lambda: deployment.pull_request(number).merged)


@contextmanager
def asked_for(platform: Platform, stage: Stage) -> Iterator[None]:
    """Main asks for players and operator as the small use case does; afterwards as before."""
    stage.deployment.fetch()
    before = stage.deployment.file(policy.PATH)
    text = policy.changed(before, platform.scenario)
    topics = iter((f"mid-run-{time.time_ns()}", f"after-mid-run-{time.time_ns()}"))
    if text is not None:
        proposing.change(stage.deployment, policy.PATH, text, "policy(initial): the small use case", next(topics))
    try:
        yield
    finally:
        if text is not None:
            proposing.change(stage.deployment, policy.PATH, before, "policy(initial): as before", next(topics))


@contextmanager
def driven(platform: Platform) -> Iterator[None]:
    """All players go round, as their machines are there."""
    driving.drive(platform.access, platform.scenario, DRIVING_MINUTES, print)
    try:
        yield
    finally:
        driving.stop(platform.access, platform.scenario, print)


def starts(platform: Platform) -> dict[str, int]:
    """Pod of the platform -> how often its containers have started again."""
    times = {}
    for pod in platform.get("-n", NAMESPACE, "pods")["items"]:
        statuses = pod["status"].get("containerStatuses", ())
        times[pod["metadata"]["name"]] = sum(status["restartCount"] for status in statuses)
    return times


def recorded(platform: Platform, topic: str, task: str) -> Mapping[str, Any]:
    """The row of a topic in the proof of the ended recording that a task asked for; empty while there is none."""

    def ask(*words: str) -> Any:
        command = [sys.executable, "-m", "robotkube.cli", "recording", *words, "-o", "json"]
        surroundings = {**os.environ, "KUBECONFIG": str(platform.installer.kubeconfig)}
        done = subprocess.run(
            command, env=surroundings, capture_output=True, text=True, timeout=COMMAND_SECONDS_MAX, check=False
        )
        assert done.stdout, done.stderr
        return json.loads(done.stdout)

    ended = [row["recording"] for row in ask("list")["recordings"] if row["state"] == "ended" and row["task"] == task]
    rows = [one for recording in ended for one in ask("verify", recording)["topics"] if one["topic"] == topic]
    return dict(rows[0]) if rows else {}


def test_a_vehicle_enrolled_in_mid_run_takes_part_in_the_use_case(
    platform: Platform, stage: Stage, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    person = Person(platform, stage, tmp_path)
    made = bags.make_bags(platform.scenario, progress=print)
    with reserved(platform, tmp_path) as machine:
        with platform.provider.volumes() as volumes:
            place_bags(platform.access, volumes, made, print)
        with asked_for(platform, stage):
            stage.await_running(f"{OTHER}/bag-player", f"{OTHER}/mqtt-bridge")
            assert not any(release.startswith(f"{NEW}/") for release in stage.releases())
            with driven(platform):
                before = starts(platform)
                pods = stage.await_running(f"{OTHER}/mqtt-bridge")
                person.proposes(capsys, "enroll", NEW, "--role", "vehicle")
                platform.provider.start_node(machine)
                stage.await_running(f"{NEW}/bag-player", f"{NEW}/mqtt-bridge")
                rule = platform.scenario.story.rule
                eventually("it meets", lambda: platform.access.tasks_of_rule(rule), MET_SECONDS_MAX)
                [task] = platform.access.tasks_of_rule(rule)
                spec = platform.access.task(*task.split("/"))["spec"]
                assert set(spec["parameters"]["vehicles"]) == {OTHER, NEW}
                eventually("they part", lambda: not platform.access.tasks_of_rule(rule), PARTED_SECONDS_MAX)
                assert starts(platform) == before, "nothing of the platform has started again"
                assert stage.await_running(f"{OTHER}/mqtt-bridge") == pods
            row = eventually("its clouds are recorded", lambda: recorded(platform, cloud_topic(NEW), task))
            assert row["stored"] > 0, row
            person.proposes(capsys, "withdraw", NEW, "--reason", "back to the values")
            stage.await_gone(f"{NEW}/bag-player", f"{NEW}/mqtt-bridge")
