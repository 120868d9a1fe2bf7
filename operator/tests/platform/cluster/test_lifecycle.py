"""The platform's life: upgraded from the chart before, its manager killed in the middle of plans, removed, installed
again. Nothing that people or robots left in it is lost.

The tests stand on each other, in this order, on a cluster `test` of their own.
"""

from __future__ import annotations

import json
import os
import time
import uuid
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from ci import publish
from ci.cluster.choosing import Choice
from ci.cluster.embedded.provider import Embedded
from ci.cluster_contract import topology
from ci.images import preparation
from ci.images.services import SERVICE_NAMES
from ci.installation import KEY_SECRET, NAMESPACE
from ci.steps import Steps
from scenarios import definition, demo
from scenarios.runner.observing import collecting
from scenarios.runner.platform.access import Access
from scenarios.runner.platform.deployment import Deployment, specification_digests
from tests.stages.platform.older_charts import columns, older_chart
from tests.stages.platform.running_platform import NAME, SCENARIO, STEPS, VARIANT, Platform, eventually, spoken
from tests.stages.platform.story import play

pytestmark = pytest.mark.thorough

ROOMS = "robotkube-suite-"
UNINSTALL_SECONDS_MAX = 180
PLAN_SECONDS_MAX = 120.0
KEPT_TASK, KEPT_NAMESPACE = "asked-by-a-person", "cloud-0"
SECRETS_OF_HELM = "helm.sh/release.v1"
FORGES_CERTIFICATE = "robotkube/forge-tls"
ACCOUNT = "broker-account"  # of an agent, and with a suffix of the platform's own processes
CERTIFICATE = ("tls.crt", "tls.key")


@dataclass
class Aged:
    """A platform installed from the older chart, with `seen`: what it held before anything was done to it."""

    platform: Platform
    seen: dict[str, Any] = field(default_factory=dict)

    def install(self) -> None:
        """`helm upgrade --install` of the present chart, and everything published."""
        wanted = topology.read(SCENARIO / "scenario.yaml", {"vehicles": str(len(self.platform.scenario.vehicles))})
        self.platform.installer.platform(preparation.everything().references(), wanted)
        publish.publish(self.platform.installer.kubeconfig)

    def holds(self) -> dict[str, Any]:
        """What must outlive upgrades and removals."""
        return {
            "tasks": self._tasks(),
            "releases": self._releases(),
            "secrets": self._secrets(),
            "claims": self._claims(),
            "recordings": self._recordings(),
        }

    def _tasks(self) -> dict[str, Any]:
        items = self.platform.get("taskdescriptions", "-A")["items"]
        return {item["metadata"]["uid"]: item["spec"] for item in items}

    def _releases(self) -> dict[str, str]:
        forge = self.platform.access.forge()
        person = self.platform.scenario.story.person
        with Deployment(forge, person, self.platform.password(person)) as deployment:
            deployment.fetch()
            return specification_digests(deployment.releases())

    def _secrets(self) -> dict[str, Any]:
        return {
            f"{namespace}/{item['metadata']['name']}": item["data"]
            for namespace in ("robotkube", *self.platform.agents)
            for item in self.platform.get("-n", namespace, "secrets")["items"]
            if item["type"] != SECRETS_OF_HELM and item["metadata"]["name"] != KEY_SECRET  # it has moved
        }

    def _claims(self) -> dict[str, str]:
        """But for those of test namespaces: what is in them is thrown away, and a volume comes with the first use."""
        items = self.platform.get("persistentvolumeclaims", "-A")["items"]
        volumes = {f"{i['metadata']['namespace']}/{i['metadata']['name']}": i["spec"].get("volumeName") for i in items}
        return {name: str(volume) for name, volume in volumes.items() if not name.startswith(ROOMS)}

    def _recordings(self) -> list[Any]:
        """All messages of the recording, read back from database and segments."""
        platform = self.platform
        agents = {node.name: node.agent for node in platform.scenario.nodes}
        with platform.provider.volumes() as volumes:
            find = collecting.segment_finder(agents, volumes)
            stored = collecting.stored(platform.access, platform.scenario, find, self.seen["events"])[1]
        return sorted((message.topic, message.stamp, message.sha256) for message in stored)


def task(name: str, application: str, parameters: Mapping[str, Any]) -> str:
    """A demand, as a person would write it."""
    event = {"rule": "by-hand", "id": name, "time": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())}
    return json.dumps(
        {
            "apiVersion": "robotkube.io/v1alpha1",
            "kind": "TaskDescription",
            "metadata": {"name": name, "namespace": KEPT_NAMESPACE},
            "spec": {
                "requester": "a-person",
                "event": {**event, "trace": uuid.uuid4().hex},
                "application": application,
                "parameters": parameters,
            },
        }
    )


@pytest.fixture(scope="module")
def aged(pytestconfig: pytest.Config, no_demo: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Aged]:
    """The older chart installed, the story run on it, a task left in it."""
    scenario = definition.load(SCENARIO, [], VARIANT)
    settings = {"vehicles": str(len(scenario.vehicles))}
    with spoken(pytestconfig):
        Embedded(NAME, Path()).down()
        installer = demo.bring_up(demo.Request(SCENARIO, settings, Choice(NAME), "cluster"), Steps(STEPS))
        references = preparation.everything().references()
        installer.argocd(references)
        wanted = topology.read(SCENARIO / "scenario.yaml", settings)
        older = older_chart(tmp_path_factory.mktemp("older"))
        if not (older / "templates" / "gate" / "namespace.yaml").exists():  # the gate stands beside the others there
            installer.signing_key(NAMESPACE)
        known = {name: one for name, one in references.items() if name not in SERVICE_NAMES}
        installer.platform(known, wanted, older)
        publish.publish(installer.kubeconfig)
        platform = Platform(installer, Embedded(NAME, installer.binaries), Access(installer.kubeconfig), scenario)
        story = play(platform, SCENARIO, VARIANT, tmp_path_factory.mktemp("story"))
    assert story.code == 0, story.talk[-3000:]
    platform.kubectl("apply", "-f", "-", text=task(KEPT_TASK, "nobody-knows", {}))
    stage = Aged(platform, {"events": [entry["event"] for entry in story.report["audit"] if entry["event"]]})
    stage.seen |= stage.holds()
    yield stage
    platform.access.disconnect()
    if os.environ.get("ROBOTKUBE_KEEP_CLUSTER") != "1":
        platform.provider.down()


def pods(platform: Platform) -> set[str]:
    """UIDs of the pods of all releases."""
    return {pod["metadata"]["uid"] for pod in platform.get("pods", "-A", "-l", "robotkube.io/agent")["items"]}


def test_an_upgrade_keeps_everything_and_renews_the_definition_of_tasks(aged: Aged) -> None:
    assert "Ready" not in columns(aged.platform)
    assert len(aged.seen["recordings"]) > 1000
    assert len(aged.seen["tasks"]) == 1
    before = pods(aged.platform)
    aged.install()
    eventually("all releases run", aged.platform.settled)
    assert "Ready" in columns(aged.platform)
    now = aged.holds()
    for what in now:
        assert now[what] == aged.seen[what], what
    assert pods(aged.platform) == before


def condition(platform: Platform, name: str, kind: str) -> str:
    """The status of a task's condition, empty when it has none."""
    description = platform.get("-n", KEPT_NAMESPACE, "taskdescription", name)
    conditions = {entry["type"]: entry["status"] for entry in description.get("status", {}).get("conditions", [])}
    return conditions.get(kind, "")


def kill_manager(platform: Platform) -> None:
    """Ends it as a crash would; its Deployment makes another."""
    chosen = ("-l", "app.kubernetes.io/name=manager", "--grace-period=0", "--force")
    platform.kubectl("-n", "robotkube", "delete", "pod", *chosen)


def recorders(platform: Platform) -> list[str]:
    """Pods and Applications of recorders."""
    names = [pod["metadata"]["name"] for pod in platform.get("-n", KEPT_NAMESPACE, "pods")["items"]]
    return [name for name in (*names, *platform.access.applications()) if "recorder-" in name]


@pytest.mark.parametrize("moment", ["", "Accepted", "Committed"], ids=["created", "accepted", "committed"])
def test_a_manager_killed_in_mid_plan_loses_nothing(aged: Aged, moment: str) -> None:
    platform = aged.platform
    name = f"killed-{moment.lower() or 'created'}"
    demand = task(name, "pose-point-cloud-recording", {"vehicles": ["vehicle-00", "vehicle-01"]})
    platform.kubectl("apply", "-f", "-", text=demand)
    if moment:
        eventually(f"task {moment}", lambda: condition(platform, name, moment) == "True", PLAN_SECONDS_MAX)
    kill_manager(platform)
    eventually("task Ready", lambda: condition(platform, name, "Ready") == "True", PLAN_SECONDS_MAX)
    assert len(recorders(platform)) == 2
    platform.kubectl("-n", KEPT_NAMESPACE, "delete", "taskdescription", name)
    kill_manager(platform)
    eventually("the recorder is gone", lambda: not recorders(platform), PLAN_SECONDS_MAX)
    eventually("main is as before", lambda: aged.holds()["releases"] == aged.seen["releases"], PLAN_SECONDS_MAX)


def test_uninstall_ends_and_says_what_stays(aged: Aged) -> None:
    platform = aged.platform
    began = time.monotonic()
    notes = platform.installer.helm("get", "notes", "robotkube", "-n", "robotkube")
    output = platform.installer.helm("uninstall", "robotkube", "-n", "robotkube", seconds=UNINSTALL_SECONDS_MAX)
    assert time.monotonic() - began < UNINSTALL_SECONDS_MAX
    names = "robotkube-seed robotkube-gate taskdescriptions.robotkube.io recordings forge database cloud-0 scratch"
    for kept in names.split():
        assert kept in output, kept
        assert kept in notes, kept
    assert platform.get("-n", "argocd", "applications,applicationsets")["items"] == []
    eventually("no pod is left", lambda: left(platform) == [])
    assert {item["status"]["phase"] for item in platform.get("namespaces")["items"]} == {"Active"}
    now = {"tasks": aged._tasks(), "claims": aged._claims()}
    assert now == {what: aged.seen[what] for what in now}


def left(platform: Platform) -> list[str]:
    """Pods of ours, but for the Job that has done its work and goes by itself."""
    return [
        pod["metadata"]["name"]
        for namespace in ("robotkube", "robotkube-gate", *platform.agents)
        for pod in platform.get("-n", namespace, "pods")["items"]
        if pod["status"].get("phase") != "Succeeded"
    ]


def accounts(held: Mapping[str, Any]) -> Mapping[str, Mapping[str, str]]:
    """The Secrets of accounts at the broker by `<namespace>/<name>`."""
    return {name: data for name, data in held["secrets"].items() if name.partition("/")[2].startswith(ACCOUNT)}


def certified(held: Mapping[str, Any]) -> set[str]:
    """The accounts that a certificate proves."""
    return {name for name, data in accounts(held).items() if set(data) >= set(CERTIFICATE)}


def without_certificates(held: Mapping[str, Any]) -> dict[str, Any]:
    """The Secrets without certificates that are made anew: of accounts, whose Secrets go with the release, and of the
    forge, whose Service gets other addresses."""
    proved = accounts(held)
    return {
        name: {key: value for key, value in data.items() if name not in proved or key not in CERTIFICATE}
        for name, data in held["secrets"].items()
        if name != FORGES_CERTIFICATE
    }


def test_installed_again_it_goes_on_with_what_was_there(aged: Aged) -> None:
    aged.install()
    wanted = {name.replace("/", "-") for name in aged.seen["releases"]}
    there = aged.platform.access.applications
    eventually("all releases are back", lambda: set(there()) == wanted and aged.platform.settled(), PLAN_SECONDS_MAX)
    now = aged.holds()
    seen = dict(aged.seen)
    assert certified(now) == certified(seen) != set()
    for held in (now, seen):
        held["secrets"] = without_certificates(held)
    for what in now:
        assert now[what] == seen[what], what
