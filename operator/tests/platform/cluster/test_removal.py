"""The remover on the running platform, switched on for these tests: a foreign pod and a sidecar are gone within 30 s,
and nothing else of the agent is touched."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from robotkube.registry.admission.core.domain import account
from tests.stages.paths import CHARTS
from tests.stages.platform.running_platform import Platform, eventually

pytestmark = pytest.mark.thorough
AGENT, RELEASE = "vehicle-02", "mqtt-bridge"
GONE_SECONDS_MAX = 30
SETTLED_SECONDS_MAX = 60
ARGOCD = account("argocd", "argocd-application-controller")
REPLICA_SETS = account("kube-system", "replicaset-controller")
SLEEPING = ["python3", "-c", "import time; time.sleep(3600)"]

Object = dict[str, Any]


def switched(platform: Platform, enabled: bool) -> None:
    """The platform as it is, with the remover or without."""
    switch = ("--reuse-values", "--set", f"remover.enabled={str(enabled).lower()}", "--no-hooks")
    platform.installer.helm("upgrade", "robotkube", str(CHARTS / "robotkube"), "-n", "robotkube", *switch)


@pytest.fixture(scope="module", autouse=True)
def remover(platform: Platform) -> Iterator[None]:
    eventually("everything runs", platform.settled)
    switched(platform, True)
    eventually("the remover runs", lambda: platform.available("robotkube", "remover"), SETTLED_SECONDS_MAX)
    yield
    switched(platform, False)
    gone = ("-n", "robotkube", "get", "deployment,serviceaccount,role", "remover", "--ignore-not-found", "-o", "name")
    eventually("the remover and its rights are gone", lambda: not platform.kubectl(*gone))


def pods(platform: Platform) -> dict[str, tuple[str, int]]:
    """The agent's pods that run: UID and restarts, by name."""
    return {
        one["metadata"]["name"]: (
            one["metadata"]["uid"],
            sum(status["restartCount"] for status in one["status"].get("containerStatuses", [])),
        )
        for one in platform.get("-n", AGENT, "pods")["items"]
        if not one["metadata"].get("deletionTimestamp")
    }


def nothing_left(platform: Platform, inspection: str) -> None:
    """The condition Removed of an Inspection says so in the end."""

    def reached() -> bool:
        status = platform.get("-n", "robotkube", "inspections", inspection).get("status", {})
        return any(one["reason"] == "NothingNamed" for one in status.get("conditions", []) if one["type"] == "Removed")

    eventually("the condition says that nothing is left", reached, SETTLED_SECONDS_MAX)


def said(platform: Platform, reason: str, words: str) -> bool:
    events = platform.get("-n", "robotkube", "events.events.k8s.io")["items"]
    return any(event["reason"] == reason and words in event.get("note", "") for event in events)


def own_container(platform: Platform) -> Object:
    return dict(platform.deployment(AGENT, RELEASE)["spec"]["template"]["spec"]["containers"][0])


def test_a_foreign_pod_is_gone_and_the_agents_own_stay(platform: Platform) -> None:
    before = pods(platform)
    own = own_container(platform)
    template = platform.deployment(AGENT, RELEASE)["spec"]["template"]["spec"]
    container = {key: own[key] for key in ("image", "securityContext")}
    spec = {
        "nodeName": AGENT,
        "automountServiceAccountToken": False,
        "securityContext": template["securityContext"],
        "containers": [{**container, "name": "main", "command": SLEEPING}],
    }
    foreign = {"apiVersion": "v1", "kind": "Pod", "metadata": {"name": "foreign", "namespace": AGENT}, "spec": spec}
    platform.kubectl("create", "--validate=false", f"--as={REPLICA_SETS}", "-f", "-", text=json.dumps(foreign))
    eventually("it is gone", lambda: "foreign" not in pods(platform), GONE_SECONDS_MAX)
    assert pods(platform) == before
    eventually("it is said", lambda: said(platform, "Removed", f"Pod {AGENT}/foreign was deleted"))
    nothing_left(platform, f"kubelet.{AGENT}")


def test_a_changed_deployment_is_as_its_chart_renders_it_again(platform: Platform) -> None:
    before = platform.deployment(AGENT, RELEASE)
    running = pods(platform)
    sidecar = {**{key: own_container(platform)[key] for key in ("image", "securityContext")}, "name": "sidecar"}
    steps = [
        {"op": "add", "path": "/spec/template/spec/containers/-", "value": {**sidecar, "command": SLEEPING}},
        {"op": "add", "path": "/metadata/annotations/example.com~1note", "value": "mine"},
    ]
    patch = ("patch", "deployment", RELEASE, "--type=json", f"--as={ARGOCD}", "-p", json.dumps(steps))
    platform.kubectl("-n", AGENT, *patch)

    def restored() -> bool:
        deployment = platform.deployment(AGENT, RELEASE)
        note = deployment["metadata"]["annotations"].get("example.com/note")
        return bool(deployment["spec"] == before["spec"]) and note is None

    eventually("the Deployment is restored", restored, GONE_SECONDS_MAX)
    eventually("it is said", lambda: said(platform, "Restored", f"Deployment {AGENT}/{RELEASE} was restored"))
    eventually("its pod runs without it", lambda: alone(platform), SETTLED_SECONDS_MAX)
    others = {name: pod for name, pod in running.items() if not name.startswith(f"{RELEASE}-")}
    assert {name: pod for name, pod in pods(platform).items() if name in others} == others
    eventually("everything runs", platform.settled)
    nothing_left(platform, "releases")


def alone(platform: Platform) -> bool:
    """Return whether the release has one pod that runs, with its own container alone."""
    listed = platform.get("-n", AGENT, "pods", "-l", f"app.kubernetes.io/instance={RELEASE}")["items"]
    names = [[one["name"] for one in pod["spec"]["containers"]] for pod in listed]
    return platform.available(AGENT, RELEASE) and names == [[own_container(platform)["name"]]]
