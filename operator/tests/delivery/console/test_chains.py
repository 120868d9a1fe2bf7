"""Chains: from whatever is asked about to the messages that caused it, and to what runs for it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from robotkube.delivery.console.adapters.cluster_documents import pod_documents, release_documents
from robotkube.delivery.console.core.chains import DONE, FAILED, GONE, WAITING, View, find_of, steps
from robotkube.delivery.console.core.documents import event_documents, plan_documents, task_document
from robotkube.foundation.documents.core.times import second_text
from tests.delivery.console import documents as given

WHOLE = [
    ("message", "/vehicles/vehicle_00/pose"),
    ("event", given.EVENT),
    ("task", given.TASK),
    ("plan", given.PLAN),
    ("pull request", "12"),
    ("commit", given.COMMIT),
    ("Application", given.RECORDER),
    ("pod", "cloud-0/recorder-0"),
    ("Application", given.BRIDGE),
]


def view(with_task: bool = True, plans: object = None, edges: tuple[str, ...] = ("start",)) -> View:
    return View(
        tasks={given.TASK: task_document(given.task())} if with_task else {},
        plans=plan_documents(plans or given.plans(), "manager"),  # type: ignore[arg-type]
        releases=release_documents([given.application(), given.application(given.BRIDGE)]),
        pods=pod_documents([given.pod()]),
        events=event_documents(given.edges(*edges), "cloud-0/detector"),
    )


@pytest.mark.parametrize(
    ("kind", "wanted"),
    [
        ("event", given.EVENT),
        ("event", given.TRACE),
        ("task", given.TASK),
        ("plan", given.PLAN),
        ("commit", given.COMMIT),
        ("commit", given.COMMIT[:12]),
    ],
)
def test_everything_of_one_event_leads_to_the_same_chain(kind: str, wanted: str) -> None:
    all_of_it = view()
    chain = list(steps(find_of(kind, wanted, all_of_it), all_of_it))
    assert sorted((step.step, step.id) for step in chain) == sorted(WHOLE)
    assert [(step.step, step.id) for step in chain][:6] == WHOLE[:6]
    assert {step.state for step in chain} == {DONE}


def test_of_a_pod_the_chain_has_its_release_alone() -> None:
    all_of_it = view()
    for kind, wanted in (("pod", "cloud-0/recorder-0"), ("release", given.RECORDER)):
        chain = [(step.step, step.id) for step in steps(find_of(kind, wanted, all_of_it), all_of_it)]
        assert chain == [pair for pair in WHOLE if pair != ("Application", given.BRIDGE)]


@pytest.mark.parametrize(("seconds", "before"), [(-60, True), (-2, True), (0, False), (2, False)])
def test_a_pod_that_ran_before_the_plan_is_no_part_of_its_time(seconds: int, before: bool) -> None:
    """The second in which the plan began may be the pod's, too: Kubernetes tells no less."""
    second = given.BEGAN // 1_000_000_000 + seconds
    started = second_text(second * 1_000_000_000)
    pods = pod_documents([given.pod(startTime=started)])
    all_of_it = replace(view(), pods=pods)
    pod = next(step for step in steps(find_of("plan", given.PLAN, all_of_it), all_of_it) if step.step == "pod")
    if before:
        assert (pod.time_ms, pod.end_ms) == (None, None)
        assert (pod.text, pod.details) == ("Running on cloud-0, ran before it", (("started", started),))
    else:
        assert pod.time_ms == second * 1000
        assert pod.text == "Running on cloud-0"


def test_times_and_links_and_values() -> None:
    all_of_it = view()
    by_step = {step.step: step for step in steps(find_of("event", given.EVENT, all_of_it), all_of_it)}
    began = given.BEGAN // 1_000_000
    assert (by_step["plan"].time_ms, by_step["plan"].end_ms) == (began, began + 4000)
    assert (by_step["pull request"].time_ms, by_step["pull request"].end_ms) == (began + 1000, began + 2000)
    assert by_step["commit"].link == f"http://forge/robotkube/deployment/commit/{given.COMMIT}"
    assert by_step["message"].text == "pose.position.x = 1.0"
    assert by_step["event"].as_json()["details"] == [{"label": "distance_m", "value": "399.8"}]
    assert by_step["task"].details[0] == ("Accepted", "Accepted, it is")


def test_an_event_that_ended_leads_to_the_withdrawal() -> None:
    all_of_it = view(with_task=False, plans=given.plans(given.withdrawal()), edges=("start", "stop"))
    chain = list(steps(find_of("event", given.EVENT, all_of_it), all_of_it))
    assert [step.step for step in chain][-4:] == ["end", "plan", "pull request", "commit"]
    assert next(step for step in chain if step.step == "task").state == GONE


def test_a_plan_that_the_gate_refused_says_so() -> None:
    refused = given.plans(on_main=False, merged=None, observed=None, error="the digest is not verified")
    all_of_it = view(plans=refused)
    by_step = {step.step: step for step in steps(find_of("plan", given.PLAN, all_of_it), all_of_it)}
    assert (by_step["pull request"].state, by_step["pull request"].text) == (FAILED, "the digest is not verified")
    assert by_step["plan"].state == FAILED


def test_a_plan_on_its_way_waits_and_one_of_before_a_restart_does_not() -> None:
    for changed, state in (({"observed": None}, WAITING), ({"observed": None, "started": None}, DONE)):
        all_of_it = view(plans=given.plans(**changed))
        by_step = {step.step: step for step in steps(find_of("plan", given.PLAN, all_of_it), all_of_it)}
        assert by_step["plan"].state == state


@pytest.mark.parametrize(
    ("kind", "wanted"), [("event", "x"), ("commit", given.COMMIT[:3]), ("pod", "a/b"), ("release", "a/b"), ("task", "")]
)
def test_of_what_is_not_known_there_is_no_chain(kind: str, wanted: str) -> None:
    assert not find_of(kind, wanted, view())
