"""The suite `interface` and a chart whose pods do not stay as they were while it is observed."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.suites.loops.interface import InterfaceSuite
from robotkube.registry.suites.ports.suites import PodRun
from robotkube.testing.suites import ENTRY, MemoryTestNamespace, make_subject

SEEN = {"endpoints": [], "publications": [], "collections": [], "answers": [], "seconds": 3.2}
OBSERVED = PodRun(json.dumps({"observation": SEEN}), 0)
TRACEBACK = [
    "Traceback (most recent call last):",
    *(f'  File "/opt/robotkube/lib/python3.11/site-packages/rclpy/{n}.py", line {n}, in spin' for n in range(12)),
    "NameError: name 'offset' is not defined",
]
FIRST = {**ENTRY, "spec": {**ENTRY["spec"], "suites": {"sets": ENTRY["spec"]["suites"]["sets"][:1]}}}
ENDED = {"terminated": {"exitCode": 1, "reason": "Error"}}
BACK_OFF = {"waiting": {"reason": "CrashLoopBackOff", "message": "back-off 10s restarting failed container"}}


def pod(ready: str = "True", since: str = "2026-11-26T10:00:00Z", **container: Any) -> dict[str, Any]:
    """A pod of one container, with its condition Ready."""
    status = {"name": "main", "ready": ready == "True", "restartCount": 0, "state": {"running": {}}, **container}
    conditions = [{"type": "Ready", "status": ready, "lastTransitionTime": since}]
    whole = {"phase": "Running", "conditions": conditions, "containerStatuses": [status]}
    return {"metadata": {"name": "greeter-1", "uid": "u1"}, "spec": {}, "status": whole}


def checks_of(*pods_seen: Sequence[Mapping[str, Any]], log: str = "") -> dict[str, Check]:
    suite = InterfaceSuite("observer@sha256:1", Jinja2Templates().render, lambda: 7, lambda: "secret")
    test_namespace = MemoryTestNamespace(runs=[OBSERVED], pods_seen=list(pods_seen), log=log)
    checks = {check.name: check for check in suite.run(make_subject(entry=FIRST), test_namespace)}
    assert test_namespace.calls[-1] == ("delete", ["greeter"])
    return checks


def test_pods_that_stay_as_they_are() -> None:
    assert list(checks_of([pod()], [pod()]).items()) == [
        ("set one: runs", Check("set one: runs", True)),
        ("set one: keeps running", Check("set one: keeps running", True)),
        ("set one: no undeclared topics", Check("set one: no undeclared topics", True)),
    ]


@pytest.mark.parametrize(
    ("after", "words"),
    [
        (
            pod("False", state=BACK_OFF, restartCount=1, lastState=ENDED),
            "pod greeter-1: container main was started again 1 time; it ended with 1 (Error)",
        ),
        (pod("False", state=ENDED), "pod greeter-1: container main ended with 1 (Error)"),
        (pod("True", "2026-11-26T10:00:02Z"), "pod greeter-1 was not ready for a while, until 2026-11-26T10:00:02Z"),
    ],
)
def test_a_container_that_ends_while_it_is_observed(after: Mapping[str, Any], words: str) -> None:
    check = checks_of([pod()], [after], log="\n".join(TRACEBACK))["set one: keeps running"]
    assert not check.passed
    assert check.found.startswith(words)
    assert check.found.endswith(TRACEBACK[-1])
    assert len(check.found) <= 1_500
    assert "go on without peers" in check.fix


def test_one_that_had_ended_when_the_observation_began() -> None:
    ended = pod("False", state=BACK_OFF, restartCount=1, lastState=ENDED)
    check = checks_of([ended], [ended], log="no map")["set one: keeps running"]
    assert not check.passed
    assert check.found.splitlines() == [
        "pod greeter-1 is not ready any more",
        "pod greeter-1: container main was restarted 1 time; it ended with 1 (Error)",
        "pod greeter-1: container main waits: CrashLoopBackOff",
        "last lines of its log:",
        "  no map",
    ]
