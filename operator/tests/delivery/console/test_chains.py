"""Chains: from whatever is asked about to the messages that caused it, and to what runs for it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from robotkube.delivery.console.adapters.cluster_documents import pod_documents, release_documents
from robotkube.delivery.console.core.chains import DONE, FAILED, GONE, WAITING, Step, View, find_of, steps
from robotkube.delivery.console.core.documents import (
    decision_documents,
    event_documents,
    plan_documents,
    task_document,
)
from robotkube.delivery.console.core.recordings import recording_documents
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


def checks_of(page: dict[str, object]) -> Step:
    """The step of the gate's checks in the chain of a plan."""
    decision = decision_documents(page)[12]
    plans = {key: {**plan, "decision": decision} for key, plan in plan_documents(given.plans(), "manager").items()}
    all_of_it = replace(view(), plans=plans)
    chain = list(steps(find_of("plan", given.PLAN, all_of_it), all_of_it))
    assert [step.step for step in chain][4:7] == ["pull request", "checks", "commit"]
    return chain[5]


def test_between_pull_request_and_commit_stand_the_gate_s_checks() -> None:
    step = checks_of(given.decisions())
    began = given.BEGAN // 1_000_000
    assert (step.state, step.text, step.kind) == (DONE, "all 2 hold", None)
    assert (step.time_ms, step.end_ms) == (began + 1750, began + 2000)
    assert step.details == (("values", "holds (3.1 ms)"), ("images", "holds"))
    assert step.link == "http://forge/robotkube/deployment/pulls/12"


@pytest.mark.parametrize(
    ("page", "state", "text"),
    [
        (given.decisions("refused", images="x is not covered"), FAILED, "1 of 2 did not hold: x is not covered"),
        (given.decisions("stale", values="main has moved"), FAILED, "1 of 2 did not hold: main has moved"),
        (given.decisions("stale"), FAILED, "all 2 hold, but main moved meanwhile"),
        (given.decisions("checked", "approval"), WAITING, "all 2 hold, and somebody has to approve it"),
        (given.decisions("checked", "closed"), WAITING, "all 2 hold, but the merge policy lets nobody merge it"),
    ],
)
def test_checks_say_what_does_not_hold_and_who_is_waited_for(page: dict[str, object], state: str, text: str) -> None:
    step = checks_of(page)
    assert (step.state, step.text) == (state, text)


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


def recorded(*ended: int | None) -> View:
    page = given.recordings(*ended)
    return replace(view(), recordings=recording_documents(page, "cloud-0", "cloud-0/recorder-0"))


@pytest.mark.parametrize("wanted", ["cloud-0/encounter-0", "encounter-0"])
def test_a_recording_leads_to_what_caused_it_and_to_no_other_recording(wanted: str) -> None:
    all_of_it = recorded(given.BEGAN + 9 * given.SECOND, None)
    chain = list(steps(find_of("recording", wanted, all_of_it), all_of_it))
    expected = [*WHOLE, ("first message", "/vehicles/vehicle_00/pose"), ("recording", "cloud-0/encounter-0")]
    assert sorted((step.step, step.id) for step in chain) == sorted(expected)
    ended = chain[-1]
    began = given.BEGAN // 1_000_000
    assert (ended.kind, ended.time_ms, ended.end_ms) == ("recording", began, began + 9000)
    assert ended.text == "ended: 97 messages, 1 gaps, on cloud-0/recordings"


def test_an_event_leads_to_all_of_its_recordings_and_says_how_they_are() -> None:
    all_of_it = recorded(given.BEGAN, None)
    chain = list(steps(find_of("event", given.EVENT, all_of_it), all_of_it))
    assert [step.text.partition(":")[0] for step in chain if step.step == "recording"] == ["ended", "at work"]
    gone = replace(all_of_it, recordings={k: {**r, "at_work": False} for k, r in all_of_it.recordings.items()})
    last = list(steps(find_of("event", given.EVENT, gone), gone))[-1]
    assert (last.state, last.text.partition(":")[0]) == (GONE, "its end was not seen")


def test_a_recording_of_nothing_that_is_known_is_alone_in_its_chain() -> None:
    page = given.recordings(None)
    page["recordings"][0] |= {"causes": [], "provenance": {}}
    alone = View(recordings=recording_documents(page, "cloud-0", "cloud-0/recorder-0"))
    chain = list(steps(find_of("recording", "cloud-0/encounter-0", alone), alone))
    assert [step.step for step in chain] == ["first message", "recording"]
    assert not find_of("recording", "encounter-9", alone)


def test_the_first_message_is_none_of_before_the_recording_when_there_is_a_later_one() -> None:
    page = given.recordings(None)
    [pose, silent] = page["recordings"][0]["topics"]
    page["recordings"][0]["topics"] = [
        pose,
        silent | {"window": [given.BEGAN + given.SECOND, given.BEGAN], "stored": 2},
    ]
    all_of_it = replace(view(), recordings=recording_documents(page, "cloud-0", "cloud-0/recorder-0"))
    chain = steps(find_of("recording", "encounter-0", all_of_it), all_of_it)
    first = next(step for step in chain if step.step == "first message")
    assert (first.id, first.time_ms) == ("/cloud", given.BEGAN // 1_000_000 + 1000)


def test_a_plan_says_what_was_decided_and_which_values_change() -> None:
    all_of_it = view()
    by_step = {step.step: step for step in steps(find_of("plan", given.PLAN, all_of_it), all_of_it)}
    assert by_step["plan"].details == (
        (f"decided for {given.TASK}", "recorder 0.2.3 on cloud-0: it is the recording agent"),
        ("created", given.RECORDER),
        ("changed", given.BRIDGE),
        (f"{given.BRIDGE} version", '"1" → "2"'),
    )
    more = {"values": [{"release": given.BRIDGE, "path": "x", "before": None, "after": "1"}], "more": 7}
    all_of_it = view(plans=given.plans(differences=more, choices=[]))
    plan = next(step for step in steps(find_of("plan", given.PLAN, all_of_it), all_of_it) if step.step == "plan")
    assert plan.details[-2:] == ((f"{given.BRIDGE} x", "(not there) → 1"), ("besides", "7 other values, in the commit"))
