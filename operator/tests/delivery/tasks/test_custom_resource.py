"""The definition of tasks on a real API server: every field is taken, and every rule refuses in words that help."""

from __future__ import annotations

import json
from typing import Any

import pytest

from robotkube.delivery.tasks.core.task_description import TaskChain, TaskDescription, TaskPlacement, read_task
from robotkube.errors import InputError
from robotkube.foundation.kubernetes.adapters.client import call
from tests.stages.kubernetes.api_calls import TASKS, Api

pytestmark = pytest.mark.toolchain

FULL: dict[str, Any] = {
    "application": "recording",
    "requirements": [{"guarantee": "latency", "atMost": 50, "unit": "ms", "verified": False}],
    "placement": {"agents": ["vehicle-00"], "roles": ["roadside"], "capabilities": ["gpu"], "antiAffinity": ["other"]},
    "priority": 0,
    "lease": {"seconds": 5},
    "conflictPolicy": "Offload",
    "offloadTo": ["cloud", "roadside"],
    "chain": {"depth": 1, "parent": "cloud-0/parent"},
    "parameters": {"vehicles": ["vehicle-00"]},
}


def read(api: Api, name: str) -> TaskDescription:
    answer = call(api.client, "GET", f"{TASKS}/{name}")
    try:
        return read_task(json.loads(answer.data))
    finally:
        answer.close()


def test_every_field_is_kept_and_read(api: Api) -> None:
    api.task("full", **FULL)
    task = read(api, "full")
    assert task.placement == TaskPlacement(("vehicle-00",), ("roadside",), ("gpu",), ("other",))
    assert (task.priority, task.lease_seconds, task.conflict_policy) == (0, 5, "Offload")
    assert (task.offload_to, task.chain) == (("cloud", "roadside"), TaskChain(1, "cloud-0/parent"))
    assert [str(requirement) for requirement in task.requirements] == ["latency at most 50 ms"]
    api.delete(f"{TASKS}/full")


def test_a_task_may_ask_by_what_is_provided_and_wait_in_the_queue(api: Api) -> None:
    asked = {"provides": "perception/detection", "conflictPolicy": "Postpone", "queue": {"secondsMax": 7}}
    api.task("provides", application=None, **asked)
    task = read(api, "provides")
    assert (task.application, task.provides, task.queue_seconds_max) == ("", "perception/detection", 7)
    assert (task.priority, task.lease_seconds) == (100, None)
    api.delete(f"{TASKS}/provides")


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ({"provides": "perception/detection"}, "exactly one of application and provides"),
        ({"application": None}, "exactly one of application and provides"),
        ({"application": "Recording"}, "spec.application"),
        ({"application": None, "provides": "a//b"}, "spec.provides"),
        ({"lease": {"seconds": 4}}, "spec.lease.seconds"),
        ({"lease": {"seconds": 86_401}}, "spec.lease.seconds"),
        ({"lease": {}}, "spec.lease.seconds"),
        ({"priority": -1}, "spec.priority"),
        ({"priority": 1001}, "spec.priority"),
        ({"priority": "high"}, "spec.priority"),
        ({"conflictPolicy": "Fight"}, "spec.conflictPolicy"),
        ({"offloadTo": ["cloud"]}, "offloadTo is only for conflictPolicy Offload"),
        ({"offloadTo": [], "conflictPolicy": "Offload"}, "spec.offloadTo"),
        ({"queue": {"secondsMax": 5}}, "queue is only for conflictPolicy Postpone"),
        ({"queue": {"secondsMax": 0}, "conflictPolicy": "Postpone"}, "spec.queue.secondsMax"),
        ({"requirements": [{"guarantee": "latency", "unit": "ms"}]}, "exactly one of atMost and atLeast"),
        ({"requirements": [{"guarantee": "latency", "unit": "parsec", "atMost": 1}]}, "spec.requirements[0].unit"),
        ({"placement": {"agents": ["Vehicle"]}}, "spec.placement.agents[0]"),
        ({"placement": {"roles": ["a"] * 33}}, "spec.placement.roles"),
        ({"chain": {"depth": 17}}, "spec.chain.depth"),
    ],
)
def test_the_api_server_refuses(api: Api, spec: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as refusal:
        api.task("wrong", **spec)
    assert words in str(refusal.value)


def test_the_chain_of_a_task_cannot_be_changed(api: Api) -> None:
    api.task("child", chain={"parent": "cloud-0/parent"})
    for chain in ({"parent": "cloud-0/other"}, None):
        with pytest.raises(InputError, match="chain says how the task came about"):
            api.merge(f"{TASKS}/child", {"spec": {"chain": chain}})
    api.merge(f"{TASKS}/child", {"spec": {"priority": 7}})
    assert read(api, "child").priority == 7
    api.delete(f"{TASKS}/child")


def test_a_renewal_is_no_new_generation(api: Api) -> None:
    api.task("leased", lease={"seconds": 5})
    renewed = {"metadata": {"annotations": {"robotkube.io/lease-renewed": "2026-11-21T10:00:08Z"}}}
    api.merge(f"{TASKS}/leased", renewed)
    task = read(api, "leased")
    assert (task.generation, task.renewed) == (1, "2026-11-21T10:00:08Z")
    api.delete(f"{TASKS}/leased")


def test_people_see_reason_and_priority(api: Api) -> None:
    api.task("shown", priority=7)
    condition = {"type": "Accepted", "status": "False", "reason": "Postponed", "message": "m"}
    condition["lastTransitionTime"] = "2026-11-21T10:00:00Z"
    queue = {"since": "2026-11-21T10:00:00.5Z", "until": "2026-11-21T10:10:00Z", "position": 1}
    entry = {
        "time": "2026-11-21T10:00:00Z",
        "generation": 1,
        "reason": "Postponed",
        "message": "m",
        "runs": ["x/y: c 1"],
    }
    status = {"observedGeneration": 1, "conditions": [condition], "queue": queue, "offloaded": True, "history": [entry]}
    api.merge(f"{TASKS}/shown/status", {"status": status})
    assert api.get(f"{TASKS}/shown")["status"] == status
    (definition,) = (
        one
        for one in api.get("/apis/robotkube.io/v1alpha1")["resources"]
        if one["kind"] == "TaskDescription" and "/" not in one["name"]
    )
    assert definition["shortNames"] == ["task", "tasks", "td"]
    header = {"Accept": "application/json;as=Table;v=v1;g=meta.k8s.io"}
    path = f"{TASKS}/shown"
    settings = ["BearerToken"]
    answer = api.client.call_api(path, "GET", header_params=header, auth_settings=settings, _preload_content=False)
    table = json.loads(answer.data)
    row = dict(zip([c["name"] for c in table["columnDefinitions"]], table["rows"][0]["cells"], strict=True))
    assert (row["Application"], row["Priority"], row["Accepted"], row["Reason"]) == (
        "recording",
        7,
        "False",
        "Postponed",
    )
    api.delete(f"{TASKS}/shown")
