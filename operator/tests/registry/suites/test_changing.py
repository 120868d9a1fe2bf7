"""Changed settings in the suite `install`: what the entry says is tried, and seen in a new pod or in the ROS graph."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.registry.evidence.core.statements import Check, SuiteResult
from robotkube.registry.suites.core.changed_settings import variations
from robotkube.registry.suites.loops.install import InstallSuite
from robotkube.registry.suites.loops.installed.changing import NOT_TRIED, SettingsChange
from robotkube.registry.suites.loops.installed.soak import Soak
from robotkube.registry.suites.ports.suites import Object, PodRun
from robotkube.testing.suites import ENTRY, MemoryTestNamespace, deployment, make_subject

RENDER = Jinja2Templates().render
STRING = {"medium": "ros", "type": "std_msgs/msg/String", "qos": {"reliability": "reliable", "durability": "volatile"}}
INTERFACES = [
    {"name": "in", "direction": "in", "topic": "/{{ values.topic }}/in", "causes": "out", **STRING},
    {"name": "out", "direction": "out", "topic": "/{{ values.topic }}/out", **STRING},
]
CHANGED = "takes-changed-settings"


def sets() -> list[Mapping[str, Any]]:
    agent = {"agent": "{{ agent }}"}
    return [
        {"name": "one", "values": {"placement": agent, "topic": "hello"}},
        {"name": "two", "values": {"placement": agent, "topic": "good_day"}},
    ]


def entry(
    settings: str | None, interfaces: Sequence[Any] = INTERFACES, also: Sequence[Mapping[str, Any]] = ({}, {})
) -> Mapping[str, Any]:
    """The entry with two test sets; `also`: more values of each."""
    said = {} if settings is None else {"settings": settings}
    tried = [{**one, "values": {**one["values"], **more}} for one, more in zip(sets(), also, strict=True)]
    return {**ENTRY, "spec": {**ENTRY["spec"], "interfaces": interfaces, "suites": {"sets": tried}, **said}}


def chart(restarts: bool) -> Any:
    """Renders a ConfigMap with the settings, and their hash into the pod when it restarts."""

    def render(values: Mapping[str, Any], release: str) -> list[dict[str, Any]]:
        settings = {"apiVersion": "v1", "kind": "ConfigMap", "metadata": {"name": release}, "data": dict(values)}
        made = deployment(release)
        if restarts:
            made["spec"]["template"]["metadata"]["annotations"] = {"hash": values["topic"]}
        return [settings, made]

    return render


def pods(uid: str) -> Sequence[Object]:
    ready = {"type": "Ready", "status": "True", "lastTransitionTime": "2026-11-26T10:00:00Z"}
    return [{"metadata": {"name": "greeter-1", "uid": uid}, "spec": {}, "status": {"conditions": [ready]}}]


def graph(*topics: tuple[str, str]) -> PodRun:
    """What the observer prints of these ends of topics."""
    ends = [
        {"topic": topic, "direction": direction, "type": "std_msgs/msg/String", "reliability": "reliable",
         "durability": "volatile", "node": "/greeter"}
        for topic, direction in topics
    ]  # fmt: skip
    nothing: Mapping[str, Any] = {"publications": [], "collections": [], "answers": [], "seconds": 3.0}
    return PodRun(json.dumps({"observation": {**nothing, "endpoints": ends}}), 0)


def judge(test_namespace: MemoryTestNamespace, settings: str | None, restarts: bool, **more: Any) -> dict[str, Check]:
    change = SettingsChange("observer@sha256:1", RENDER, lambda: "secret")
    suite = InstallSuite(RENDER, lambda: 7, Soak("observer@sha256:1", RENDER, lambda: "secret", 0), change)
    subject = make_subject(chart(restarts), entry(settings, **more))
    return {check.name: check for check in suite.run(subject, test_namespace)}


NEW = (("/good_day/in", "in"), ("/good_day/out", "out"))
OLD = (("/hello/in", "in"), ("/hello/out", "out"))


def test_a_new_pod_has_the_other_settings() -> None:
    test_namespace = MemoryTestNamespace(pods_seen=[pods("u1"), pods("u2")])
    checks = judge(test_namespace, "restart", restarts=True)
    assert checks[CHANGED] == Check(CHANGED, True, "a new pod has them")
    assert [call for call in test_namespace.calls if call[0] == "apply"] == [("apply", ["greeter", "greeter"])] * 2
    assert test_namespace.objects == {}


def test_a_pod_that_stays_goes_on_with_the_settings_before() -> None:
    checks = judge(MemoryTestNamespace(pods_seen=[pods("u1"), pods("u1")]), "restart", restarts=False)
    assert checks[CHANGED].found == "its pod is the one from before, which started with other settings"
    assert "`restart`, the pod is replaced" in checks[CHANGED].fix
    assert checks["stops-within-its-grace"].passed


def test_a_process_that_watches_opens_other_topics_in_the_same_pod() -> None:
    test_namespace = MemoryTestNamespace(runs=[graph(*NEW)], pods_seen=[pods("u1")] * 3)
    checks = judge(test_namespace, "watched", restarts=False)
    seen = "it opened the topics of two, and its pod stayed; shown to be at work: values.topic"
    assert checks[CHANGED] == Check(CHANGED, True, seen)
    [sent] = [call[1]["files"]["config.json"] for call in test_namespace.calls if call[0] == "run_pod"]
    assert [topic["topic"] for topic in json.loads(sent)["topics"]] == ["/good_day/in", "/good_day/out"]


@pytest.mark.parametrize(
    "also",
    [({"greeting": "hello"}, {"greeting": "good day"}), ({"greeting": "hello"}, {"greeting": "hello"})],
    ids=["changed", "the same in every set"],
)
def test_values_that_no_topic_shows_are_named(also: Sequence[Mapping[str, Any]]) -> None:
    """The process read `greeting` once, and the check passed without a word of it."""
    test_namespace = MemoryTestNamespace(runs=[graph(*NEW)], pods_seen=[pods("u1")] * 3)
    also = [{**more, "resources": {"requests": {"cpu": "1m"}}} for more in also]
    check = judge(test_namespace, "watched", restarts=False, also=also)[CHANGED]
    assert (check.passed, check.found) == (
        True,
        "it opened the topics of two, and its pod stayed; shown to be at work: values.topic; "
        "not shown: values.greeting",
    )
    assert SuiteResult("install", "3", "passed", (check,), 1.0).reserved == (check,)


@pytest.mark.parametrize(
    ("seen", "after", "words"),
    [
        (OLD, "u1", "not open: ros in /good_day/in, ros out /good_day/out"),
        (OLD, "u1", "still open, as with the settings before: ros in /hello/in, ros out /hello/out"),
        ((*NEW, OLD[1]), "u1", "still open, as with the settings before: ros out /hello/out"),
        (NEW, "u2", "pod greeter-1 is gone: it was evicted, deleted or replaced"),
    ],
)
def test_a_process_that_only_says_that_it_watches(seen: Sequence[tuple[str, str]], after: str, words: str) -> None:
    test_namespace = MemoryTestNamespace(runs=[graph(*seen)], pods_seen=[pods("u1"), pods(after), pods(after)])
    check = judge(test_namespace, "watched", restarts=False)[CHANGED]
    assert (check.passed, words in check.found) == (False, True), check.found


def test_a_chart_that_is_not_ready_with_other_settings() -> None:
    test_namespace = MemoryTestNamespace(readiness=["", "Deployment greeter was not ready after 60 s"])
    check = judge(test_namespace, "watched", restarts=False)[CHANGED]
    assert (check.passed, check.found) == (False, "Deployment greeter was not ready after 60 s")


def test_a_process_that_ends_by_itself_is_told_with_its_log_and_not_to_follow_settings() -> None:
    ended = {"terminated": {"exitCode": 1, "reason": "Error"}}
    status = {"name": "greeter", "restartCount": 1, "state": {"running": {}}, "lastState": ended}
    [pod] = pods("u1")
    again = [{**pod, "status": {**pod["status"], "containerStatuses": [status]}}]
    test_namespace = MemoryTestNamespace(runs=[graph(*NEW)], pods_seen=[pods("u1"), again, again, again], log="tired")
    check = judge(test_namespace, "watched", restarts=False)[CHANGED]
    assert (check.passed, check.fix.startswith("the process ended by itself")) == (False, True), check.fix
    assert "pod greeter-1: container greeter was started again 1 time; it ended with 1 (Error)" in check.found
    assert "tired" in check.found


def test_an_entry_that_says_nothing_is_not_tried() -> None:
    assert CHANGED not in judge(MemoryTestNamespace(), None, restarts=False)


def test_what_the_graph_cannot_show_is_said() -> None:
    fixed = [{**interface, "topic": f"/{interface['name']}"} for interface in INTERFACES]
    checks = judge(MemoryTestNamespace(), "watched", restarts=False, interfaces=fixed)
    assert checks[CHANGED] == Check(CHANGED, True, NOT_TRIED)


def test_one_value_at_a_time_is_another_than_the_first_set_s() -> None:
    first = {"placement": {"agent": "a"}, "x": {"y": 1, "z": [1]}, "same": 1}
    other = {"placement": {"agent": "b"}, "x": {"y": 2, "z": [1, 2]}, "same": 1, "more": True}
    assert list(variations(first, [other])) == [
        ("values.x.y", {**first, "x": {"y": 2, "z": [1]}}),
        ("values.x.z", {**first, "x": {"y": 1, "z": [1, 2]}}),
        ("values.more", {**first, "more": True}),
    ]
