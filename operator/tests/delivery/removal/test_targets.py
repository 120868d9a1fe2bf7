"""Which of the strangers that are named may be taken away, and what is said of the others."""

from __future__ import annotations

from typing import Any

import pytest

from robotkube.delivery.removal.core.named import AGE_SECONDS_MAX, SKEW_SECONDS_MAX, read_inspection
from robotkube.delivery.removal.core.targets import (
    NOT_AN_AGENTS,
    NOT_BY_API,
    NOT_BY_POLICY,
    NOT_SAID,
    Left,
    PodTarget,
    RemovalPolicy,
    Target,
    WorkloadTarget,
    merged,
    target_of,
)
from tests.delivery.removal.examples import NOW_NS, UID, inspection, stranger, workload_target

POLICY = RemovalPolicy(frozenset({"vehicle-00"}))
DEPLOYMENT = {"generation": 3, "excess": ["/spec/template/spec/containers/1"], "reason": "NotOfTheChart"}


def target(entry: dict[str, Any], policy: RemovalPolicy = POLICY, looks_at: str = "kubelet") -> Target:
    [one] = read_inspection(inspection(entry), "Removed").strangers
    return target_of(one, looks_at, policy)


def left(*arguments: Any, **more: Any) -> Left:
    answer = target(*arguments, **more)
    assert isinstance(answer, Left)
    return answer


def test_a_pod_goes_at_once_and_one_with_a_foreign_container_in_order() -> None:
    assert target(stranger()) == PodTarget("vehicle-00", "foreign", UID, 1)
    assert target(stranger("Container", container="side", reason="ForeignContainer")) == PodTarget(
        "vehicle-00", "foreign", UID, 10
    )


def test_a_deployment_loses_what_is_named() -> None:
    answer = target(stranger("Deployment", "detector", **DEPLOYMENT), looks_at="releases")
    assert answer == workload_target("/spec/template/spec/containers/1")


@pytest.mark.parametrize(
    ("entry", "looks_at", "words"),
    [
        (stranger("StaticPod"), "kubelet", "take its file out of the kubelet's folder of static pods"),
        (stranger("Container", container="x"), "machine", "stop the container there"),
        (stranger("Pod", reason="ForeignPod"), "kubelet", "stop the container there"),
        (stranger("StaticPod", namespace="elsewhere"), "kubelet", "no request to it ends it"),
    ],
)
def test_what_the_api_server_did_not_start_is_not_ended_by_it(entry: dict[str, Any], looks_at: str, words: str) -> None:
    answer = left(entry, looks_at=looks_at)
    assert answer.reason == NOT_BY_API
    assert words in answer.sentence


@pytest.mark.parametrize("kind", ["Pod", "Container", "Deployment"])
@pytest.mark.parametrize("namespace", ["robotkube", "kube-system", "vehicle-01", ""])
def test_only_in_agents_namespaces(kind: str, namespace: str) -> None:
    assert left(stranger(kind, namespace=namespace, **DEPLOYMENT)).reason == NOT_AN_AGENTS


def test_what_the_policy_leaves() -> None:
    without_pods = RemovalPolicy(POLICY.agents, pods=False)
    without_workloads = RemovalPolicy(POLICY.agents, workloads=False)
    assert left(stranger(), without_pods).reason == NOT_BY_POLICY
    assert "remover.pods is false" in left(stranger(), without_pods).sentence
    assert left(stranger("Deployment", **DEPLOYMENT), without_workloads).reason == NOT_BY_POLICY
    assert isinstance(target(stranger(), without_workloads), PodTarget)
    assert isinstance(target(stranger("Deployment", **DEPLOYMENT), without_pods), WorkloadTarget)


@pytest.mark.parametrize(
    "entry",
    [
        stranger(uid=""),
        stranger("Deployment", generation=3),
        stranger("Deployment", uid="", generation=3, excess=["/metadata/labels/a"]),
        stranger("StatefulSet", **DEPLOYMENT),
        stranger("ConfigMap", **DEPLOYMENT),
    ],
)
def test_what_is_not_said_exactly_is_left(entry: dict[str, Any]) -> None:
    assert left(entry).reason == NOT_SAID


def test_what_two_entries_say_of_one_deployment_is_one_target() -> None:
    one, two, later = workload_target("/a", "/b"), workload_target("/b", "/c"), workload_target("/d", generation=4)
    assert merged([one, two, later]) == [workload_target("/a", "/b", "/c"), later]


@pytest.mark.parametrize(
    ("age_seconds", "believed"),
    [(0, True), (AGE_SECONDS_MAX, True), (AGE_SECONDS_MAX + 1, False), (-SKEW_SECONDS_MAX - 1, False)],
)
def test_an_old_look_is_not_believed(age_seconds: int, believed: bool) -> None:
    named = read_inspection(inspection(at_ns=NOW_NS - age_seconds * 10**9), "Removed")
    assert named.is_believed(NOW_NS) is believed


@pytest.mark.parametrize("status", [{}, {"observedTime": "yesterday"}, {"conditions": []}])
def test_what_does_not_say_that_it_saw_is_not_believed(status: dict[str, Any]) -> None:
    whole = inspection(stranger())
    whole["status"] = {**whole["status"], **status} if status else {}
    assert not read_inspection(whole, "Removed").is_believed(NOW_NS)
    assert not read_inspection(inspection(seen="False"), "Removed").is_believed(NOW_NS)
    assert not read_inspection({}, "Removed").is_believed(NOW_NS)
