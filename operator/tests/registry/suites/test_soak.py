"""The soak of the suite `install`: what became of the chart's pods while they were under traffic."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from robotkube.errors import InputError
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.suites.core.memory_growth import MemorySample
from robotkube.registry.suites.core.soaked_pods import unsteady
from robotkube.registry.suites.loops.install import InstallSuite
from robotkube.registry.suites.loops.installed.changing import SettingsChange
from robotkube.registry.suites.loops.installed.memory_sampling import MemoryWatch
from robotkube.registry.suites.loops.installed.soak import Soak
from robotkube.registry.suites.ports.suites import PodRun
from robotkube.testing.suites import ENTRY, MemoryTestNamespace, make_subject

RENDER = Jinja2Templates().render
CHANGE = SettingsChange("observer@sha256:1", RENDER, lambda: "secret")
STRING = {"medium": "ros", "type": "std_msgs/msg/String", "qos": {"reliability": "reliable", "durability": "volatile"}}
INTERFACES = [
    {"name": "in", "direction": "in", "topic": "/{{ values.word }}", **STRING},
    {"name": "out", "direction": "out", "topic": "/out", **STRING},
]
SOAKED = {**ENTRY, "spec": {**ENTRY["spec"], "interfaces": INTERFACES}}
NOTHING = {"endpoints": [], "publications": [], "collections": [], "answers": [], "seconds": 61.0}
SENT = PodRun(json.dumps({"observation": NOTHING}), 0)
ENDED_EARLY = PodRun(json.dumps({"observation": {**NOTHING, "seconds": 12.0}}), 0)


def pod(name: str = "greeter-1", uid: str = "u1", **status: Any) -> dict[str, Any]:
    """A ready pod of one container."""
    ready = {"type": "Ready", "status": "True", "lastTransitionTime": "2026-11-26T10:00:00Z"}
    container = {"name": "main", "ready": True, "restartCount": 0, "state": {"running": {}}}
    whole = {"phase": "Running", "conditions": [ready], "containerStatuses": [container], **status}
    return {"metadata": {"name": name, "uid": uid}, "spec": {}, "status": whole}


def container(**of_it: Any) -> list[Mapping[str, Any]]:
    return [{"name": "main", "ready": True, "restartCount": 0, "state": {"running": {}}, **of_it}]


def readiness(status: str, since: str, message: str = "") -> list[Mapping[str, Any]]:
    return [{"type": "Ready", "status": status, "lastTransitionTime": since, "message": message}]


def test_pods_that_stay_as_they_are() -> None:
    assert unsteady([pod()], [copy.deepcopy(pod())]) == []
    assert unsteady([], []) == []
    done = [{"name": "first", "restartCount": 0, "state": {"terminated": {"exitCode": 0, "reason": "Completed"}}}]
    assert unsteady([pod(initContainerStatuses=done)], [pod(initContainerStatuses=done)]) == []


KILLED = {"terminated": {"exitCode": 137, "reason": "OOMKilled"}}


@pytest.mark.parametrize(
    ("after", "problem"),
    [
        ([], "pod greeter-1 is gone: it was evicted, deleted or replaced"),
        (
            [pod(containerStatuses=container(restartCount=1, lastState=KILLED))],
            "pod greeter-1: container main was started again 1 time; it ended with 137 (OOMKilled)",
        ),
        (
            [pod(containerStatuses=container(state={"terminated": {"exitCode": 3, "reason": "Error"}}))],
            "pod greeter-1: container main ended with 3 (Error)",
        ),
        (
            [pod(conditions=readiness("False", "2026-11-26T10:00:09Z", "containers with unready status: [main]"))],
            "pod greeter-1 is not ready any more: containers with unready status: [main]",
        ),
        (
            [pod(conditions=readiness("True", "2026-11-26T10:00:09Z"))],
            "pod greeter-1 was not ready for a while, until 2026-11-26T10:00:09Z",
        ),
        ([pod(), pod("greeter-2", "u2")], "pod greeter-2 came while the chart ran"),
        ([pod(uid="u9")], "pod greeter-1 is gone: it was evicted, deleted or replaced"),
    ],
)
def test_what_did_not_stay_is_named(after: Sequence[Mapping[str, Any]], problem: str) -> None:
    assert problem in unsteady([pod()], after)


def test_what_a_container_did_before_does_not_count() -> None:
    started = pod(containerStatuses=container(restartCount=2, lastState=KILLED))
    assert unsteady([started], [started]) == []


class NoMemory:
    """A cluster that does not let memory be read."""

    def read(self, pods: Sequence[Mapping[str, Any]]) -> Sequence[MemorySample]:
        raise InputError("no right to read it")


class Growing:
    """Everything that a container of 10 to 30 MiB did, at once."""

    def read(self, pods: Sequence[Mapping[str, Any]]) -> Sequence[MemorySample]:
        sizes = {16.0: 10, 26.0: 20, 46.0: 30}
        return [MemorySample("greeter-1", "main", seconds, size << 20) for seconds, size in sizes.items()]


def growing_watch() -> MemoryWatch:
    return MemoryWatch(Growing(), 10, lambda: 0.0)


UNMEASURED = MemoryWatch(NoMemory(), 10, lambda: 0.0)


def soaked(
    test_namespace: MemoryTestNamespace,
    seconds: int = 60,
    entry: Mapping[str, Any] = SOAKED,
    watch: MemoryWatch | None = None,
) -> dict[str, Check]:
    soak = Soak("observer@sha256:1", RENDER, lambda: "secret", seconds, watch or UNMEASURED)
    suite = InstallSuite(RENDER, lambda: 7, soak, CHANGE)
    return {check.name: check for check in suite.run(make_subject(entry=entry), test_namespace)}


def test_a_chart_that_keeps_running() -> None:
    test_namespace = MemoryTestNamespace(runs=[SENT], pods_seen=[[pod()], [pod()]])
    checks = soaked(test_namespace)
    assert list(checks)[:3] == ["installs", "becomes-ready", "keeps-running"]
    words = "60 s with traffic on 1 inputs; memory: not measured: no right to read it"
    assert checks["keeps-running"] == Check("keeps-running", True, words)
    _, call = next(call for call in test_namespace.calls if call[0] == "run_pod")
    config = json.loads(call["files"]["config.json"])
    assert (call["image"], config["load_seconds"], config["node"]) == ("observer@sha256:1", 60.0, "suite_secret")
    assert [topic["topic"] for topic in config["topics"]] == ["/hello", "/out"]


def test_a_chart_that_grows_under_traffic_is_refused() -> None:
    limited = pod()
    limited["spec"] = {"containers": [{"name": "main", "resources": {"limits": {"memory": "100Mi"}}}]}
    checks = soaked(MemoryTestNamespace(runs=[SENT], pods_seen=[[limited], [limited]]), watch=growing_watch())
    words = "pod greeter-1: container main grew from 10 to 30 MiB under traffic, by 20 % of its memory limit"
    assert not checks["keeps-running"].passed
    assert words in checks["keeps-running"].found


def test_ten_seconds_are_too_short_to_claim_anything() -> None:
    soak = soaked(MemoryTestNamespace(runs=[SENT], pods_seen=[[pod()], [pod()]]), 10, watch=growing_watch())
    words = "memory: not measured: 10 s are too short to claim anything, at least 45 are needed"
    assert soak["keeps-running"].found == f"10 s with traffic on 1 inputs; {words}"


def test_a_chart_that_dies_under_traffic_is_stopped_and_judged() -> None:
    again = pod(containerStatuses=container(restartCount=2, lastState=KILLED))
    checks = soaked(MemoryTestNamespace(runs=[SENT], pods_seen=[[pod()], [again]]))
    assert not checks["keeps-running"].passed
    assert "container main was started again 2 times; it ended with 137 (OOMKilled)" in checks["keeps-running"].found
    assert checks["keeps-running"].fix
    assert checks["leaves-nothing-behind"].passed


def test_without_a_soak_nothing_is_sent_and_nothing_claimed() -> None:
    test_namespace = MemoryTestNamespace()
    assert "keeps-running" not in soaked(test_namespace, seconds=0)
    assert "run_pod" not in [name for name, _ in test_namespace.calls]


@pytest.mark.parametrize(
    ("test_namespace", "words"),
    [
        (MemoryTestNamespace(runs=[PodRun("no such type", 1)]), "no such type"),
        (MemoryTestNamespace(runs=[ENDED_EARLY]), "the observer was ended after 12 of 60 s"),
        (MemoryTestNamespace(seconds_left=61.0), "61 s are left of the run; raise `seconds` of the suite"),
    ],
)
def test_what_could_not_be_soaked_has_not_passed(test_namespace: MemoryTestNamespace, words: str) -> None:
    checks = soaked(test_namespace)
    assert not checks["keeps-running"].passed
    assert words in checks["keeps-running"].found
