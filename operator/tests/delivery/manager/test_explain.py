"""Questions about tasks: the answers are those of the planner, over snapshots, and change nothing."""

from __future__ import annotations

import json
import threading
from dataclasses import replace
from typing import Any

import pytest

from robotkube.delivery.manager.loops import explain
from robotkube.delivery.manager.loops.explain import Explainer
from robotkube.delivery.manager.loops.reconciler import DEPLOYMENT
from robotkube.delivery.tasks.core.holds import DeviceHold
from robotkube.errors import UnavailableError
from robotkube.testing.clusters import MemoryTasks
from tests.stages.delivery.manager.manager_in_memory import START_NS, Stage

METADATA = b'{"metadata": {"name": "new", "namespace": "cloud-0", %s}}'
EVENT = {"rule": "asked", "id": "x", "trace": "b" * 32, "time": "2026-11-21T10:00:00Z"}


def document(name: str = "new", **spec: Any) -> dict[str, Any]:
    full = {
        "requester": "somebody",
        "event": EVENT,
        "application": "pose-point-cloud-recording",
        "parameters": {"vehicles": ["vehicle-00", "vehicle-01"]},
        **spec,
    }
    return {"metadata": {"namespace": "cloud-0", "name": name}, "spec": full}


def hold(stage: Stage, agent: str) -> None:
    until = START_NS + int((stage.seconds + 60) * 1e9)
    stage.cluster.machines = [
        replace(node, hold=DeviceHold(agent, until, "driving") if node.agent == agent else None)
        for node in stage.cluster.machines
    ]


def park(stage: Stage) -> None:
    stage.cluster.machines = [replace(node, hold=None) for node in stage.cluster.machines]


@pytest.fixture
def explainer(stage: Stage) -> Explainer:
    return Explainer(stage.manager.what_if, stage.tasks)


def test_a_task_that_is_not_submitted(stage: Stage, explainer: Explainer) -> None:
    tip = stage.repository.tip
    status, answer = explainer(json.dumps(document()).encode())
    assert (status, answer["task"], answer["outcome"]) == (200, "cloud-0/new", "Accepted")
    assert "cloud-0/recorder-vehicle-00-vehicle-01" in answer["releases"]
    added = {change["path"] for change in answer["changes"] if change["before"] is None}
    assert "releases/cloud-0/recorder-vehicle-00-vehicle-01.yaml" in added
    changed = [change for change in answer["changes"] if change["path"] == "releases/vehicle-00/mqtt-bridge.yaml"]
    assert "pointcloud" in changed[0]["after"]
    assert "pointcloud" not in changed[0]["before"]
    assert (stage.repository.tip, stage.tasks.objects) == (tip, {})


def test_a_question_does_not_make_an_edit_stand(stage: Stage, explainer: Explainer) -> None:
    """Under edits: respect, an edit stands as long as the same is wanted as when it was first seen; a question about
    a task must not count as such a wish."""
    bridge = "releases/vehicle-00/mqtt-bridge.yaml"
    stage.repository.push({"policies/edits.yaml": "edits: respect\n"}, "policy")
    text = stage.repository.files(stage.repository.tip, ("releases",))[bridge]
    stage.repository.push({bridge: f"{text}# looked at\n"}, "nothing changed")
    stage.go(wake=DEPLOYMENT)
    key = stage.ask()
    question = {"metadata": stage.tasks.objects[key]["metadata"], "spec": stage.tasks.objects[key]["spec"]}
    assert explainer(json.dumps(question).encode())[1]["outcome"] == "Accepted"
    stage.settle()
    assert "pointcloud" in str(stage.releases()[bridge].values)


def test_a_task_that_would_be_refused(explainer: Explainer) -> None:
    status, answer = explainer(json.dumps(document(application="nothing")).encode())
    assert (status, answer["outcome"], answer["reason"]) == (200, "Refused", "UnknownApplication")
    assert answer["changes"] == []
    _, answer = explainer(json.dumps(document(colour="red")).encode())
    assert (answer["reason"], "spec.colour: unknown key" in answer["message"]) == ("InvalidParameters", True)


def test_a_task_that_is_there(stage: Stage, explainer: Explainer) -> None:
    key = stage.ask()
    stage.settle()
    status, answer = explainer(json.dumps({"task": key}).encode())
    assert (status, answer["outcome"], answer["changes"]) == (200, "Accepted", [])
    assert explainer(b'{"task": "cloud-0/nothing"}')[0] == 404


def test_a_task_whose_changes_would_wait_for_a_vehicle_that_drives(stage: Stage, explainer: Explainer) -> None:
    hold(stage, "vehicle-00")
    _, answer = explainer(json.dumps(document()).encode())
    assert answer["outcome"] == "Accepted"
    assert "vehicle-00/mqtt-bridge: vehicle-00 holds changes until 2026-11-21T" in answer["waits"]
    assert answer["waits"].endswith("driving")
    assert f"cloud-0/new waits, HeldByAgent: {answer['waits']}" in answer["lines"]
    _, free = explainer(json.dumps(document(parameters={"vehicles": ["vehicle-01", "vehicle-02"]})).encode())
    assert (free["outcome"], free["waits"]) == ("Accepted", "")
    key = stage.ask()
    stage.go()
    _, there = explainer(json.dumps({"task": key}).encode())
    assert there["waits"] == stage.tasks.objects[key]["status"]["conditions"][1]["message"]
    park(stage)
    assert explainer(json.dumps({"task": key}).encode())[1]["waits"] == ""


@pytest.mark.parametrize(
    ("body", "status", "words"),
    [
        (b"", 400, "no JSON"),
        (b"[" * 100_000, 400, "no JSON"),
        (b"[]", 400, "must be a JSON object"),
        (b'{"x": NaN}', 400, "not a JSON number"),
        (b'{"spec": {}}', 400, "needs name and namespace"),
        (b'{"metadata": {"name": 3, "namespace": "a"}}', 400, "needs name and namespace"),
        (METADATA % b'"annotations": 7', 400, "metadata.annotations: must be an object with texts"),
        (METADATA % b'"annotations": "a"', 400, "metadata.annotations: must be an object with texts"),
        (METADATA % b'"annotations": {"a": 7}', 400, "metadata.annotations: must be an object with texts"),
        (METADATA % b'"generation": "1"', 400, "metadata.generation: must be a whole number"),
        (b'{"task": ["a"]}', 404, "there is no task ['a']"),
        (b" " * 300_000, 413, "at most 262144"),
    ],
)
def test_what_is_no_question(explainer: Explainer, body: bytes, status: int, words: str) -> None:
    answered, answer = explainer(body)
    assert (answered, words in answer["message"]) == (status, True)


def test_one_question_at_a_time_and_faults_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(explain, "BUSY_SECONDS_MAX", 0.01)
    asked, answer = threading.Event(), threading.Event()

    def slow(task: Any) -> Any:
        asked.set()
        assert answer.wait(10)
        raise UnavailableError("the forge is away")

    explainer = Explainer(slow, MemoryTasks())
    answers = []
    question = json.dumps(document()).encode()
    thread = threading.Thread(target=lambda: answers.append(explainer(question)))
    thread.start()
    assert asked.wait(10)
    assert explainer(question)[0] == 429
    answer.set()
    thread.join(10)
    assert answers == [(503, {"message": "the forge is away"})]


def test_what_would_go_with_a_task(stage: Stage, explainer: Explainer) -> None:
    """Its own recorder stops; the bridges stay, with the topics that others ask for; nothing is changed by asking."""
    key, other = stage.ask(), stage.ask("second", ("vehicle-01", "vehicle-02"))
    stage.settle()
    tip = stage.repository.tip
    status, answer = explainer(json.dumps({"withdraw": key}).encode())
    assert (status, answer["outcome"], answer["releases"]) == (
        200,
        "Withdrawn",
        ["cloud-0/recorder-vehicle-00-vehicle-01"],
    )
    assert answer["lines"][0] == f"{key} would be withdrawn"
    assert any(line.startswith("stops cloud-0/recorder-vehicle-00-vehicle-01 ") for line in answer["lines"])
    assert any(line.startswith("changes vehicle-00/mqtt-bridge ") for line in answer["lines"])
    assert not any("vehicle-02/mqtt-bridge" in line or other in line for line in answer["lines"])
    assert stage.repository.tip == tip
    assert {key, other} <= set(stage.tasks.objects)
    assert explainer(b'{"withdraw": "cloud-0/nothing"}')[0] == 404
    assert explainer(b'{"withdraw": null}')[0] == 404
