"""Every check of the probe: ok where nothing is wrong, failed with one Node changed, and never ok without an answer."""

from __future__ import annotations

from typing import Any

import pytest

from robotkube.delivery.preflight.core.findings import FAILED, NOT_CHECKED, OK, ClusterFinding, Unread
from robotkube.delivery.preflight.core.probing.answers import DiskSpace
from robotkube.delivery.preflight.core.probing.checks import PROBE_CHECKS
from robotkube.delivery.preflight.core.probing.outcomes import NodeOutcome, Probed
from robotkube.delivery.preflight.core.probing.targets import probe_target
from tests.stages.delivery.preflight.preflight_facts import AGENTS, rendering
from tests.stages.delivery.preflight.probed_nodes import (
    API,
    BROKER,
    GIB,
    IMAGE,
    TARGET,
    answered,
    outcomes,
    probe_finding,
    probed,
)

NO_POLICIES = {"agents": [{"name": name, "role": role} for name, role in AGENTS.items()]}
POLICIES = {**NO_POLICIES, "networkPolicies": {"enabled": True}}
NO_POD = Unread("no pod of the probe runs there: its kubelet says nothing")
NOT_PULLED = NodeOutcome(False, "ErrImagePull: 401 Unauthorized", NO_POD)


def said(found: ClusterFinding) -> str:
    """What a failed check says of its problems: each has what, where, why and fix."""
    assert found.result == FAILED, found
    assert all(problem.what and problem.where and problem.why and problem.fix for problem in found.problems), found
    return "\n".join(f"{problem.where}: {problem.what} -> {problem.fix}" for problem in found.problems)


@pytest.mark.parametrize("check", [one.name for one in PROBE_CHECKS])
def test_every_check_is_ok_where_nothing_is_wrong(check: str) -> None:
    judged = probe_finding(check, probed())
    assert (judged.result, judged.problems) == (OK, ()), judged


@pytest.mark.parametrize("check", [one.name for one in PROBE_CHECKS])
def test_no_check_is_ok_without_a_probe(check: str) -> None:
    judged = probe_finding(check, Unread("nothing was started: the account may not create namespaces in the cluster"))
    assert judged.result == NOT_CHECKED
    assert "may not create namespaces" in judged.says


@pytest.mark.parametrize("check", ["disks", "names", "clocks", "broker", "network-policies"])
def test_no_check_is_ok_without_the_answer_of_each_node(check: str) -> None:
    judged = probe_finding(check, probed(nodes=outcomes(vehicle_01=NodeOutcome(True, "", NO_POD))))
    assert judged.result == NOT_CHECKED
    assert "Node vehicle-01: no pod of the probe runs there" in judged.says


@pytest.mark.parametrize("check", ["pull", "disks", "names", "clocks", "network-policies"])
def test_no_check_is_ok_of_a_node_that_is_not_asked(check: str) -> None:
    judged = probe_finding(check, probed(unasked={"edge-0": "it is not Ready (see check agents-ready)"}))
    assert judged.result == NOT_CHECKED
    assert "Node edge-0: it is not Ready" in judged.says


def test_an_image_that_a_node_does_not_get() -> None:
    text = said(probe_finding("pull", probed(nodes=outcomes(vehicle_00=NOT_PULLED))))
    assert f"Node vehicle-00: {IMAGE} is not pulled: ErrImagePull: 401 Unauthorized -> correct images.platform" in text


def test_an_image_that_needs_a_secret_is_not_known() -> None:
    made = rendering()
    for item in made.of_kind("Deployment"):
        item["spec"]["template"]["spec"]["imagePullSecrets"] = [{"name": "registry"}]
    judged = probe_finding("pull", probed(nodes=outcomes(vehicle_00=NOT_PULLED)), rendering=made)
    assert judged.result == NOT_CHECKED
    assert "Node vehicle-00 asks for imagePullSecrets, which the probe has not" in judged.says


def test_a_node_on_which_nothing_starts() -> None:
    hanging = NodeOutcome(None, "FailedCreatePodSandBox: network is not ready", NO_POD)
    text = said(probe_finding("pull", probed(nodes=outcomes(vehicle_00=hanging))))
    assert "no pod started there in time: FailedCreatePodSandBox: network is not ready -> kubectl describe node" in text


@pytest.mark.parametrize(
    ("what", "disk", "words"),
    [
        ("pods", DiskSpace(9 * GIB, 100 * GIB), "9% (9.0 GiB) is free where it keeps its pods"),
        ("images", DiskSpace(14 * GIB, 100 * GIB), "14% (14.0 GiB) is free where it keeps its images"),
        ("images", DiskSpace(GIB, 2 * GIB), "50% (1.0 GiB) is free where it keeps its images"),
    ],
)
def test_a_disk_that_is_nearly_full(what: str, disk: DiskSpace, words: str) -> None:
    good = {"pods": DiskSpace(50 * GIB, 100 * GIB), "images": DiskSpace(50 * GIB, 100 * GIB)}
    text = said(probe_finding("disks", probed(nodes=answered("vehicle-00", disks=good | {what: disk}))))
    assert f"Node vehicle-00: {words} -> free space on it" in text


def test_a_name_that_is_not_resolved() -> None:
    nodes = answered("vehicle-00", names={API: "", BROKER: "Name or service not known"})
    text = said(probe_finding("names", probed(nodes=nodes)))
    assert f"Node vehicle-00: {BROKER} is not resolved: Name or service not known -> correct clusterDomain" in text


@pytest.mark.parametrize(("ahead", "side"), [(0.254, "behind"), (-0.246, "ahead")])
def test_a_clock_that_is_wrong(ahead: float, side: str) -> None:
    text = said(probe_finding("clocks", probed(nodes=answered("vehicle-00", clock_ahead=ahead))))
    assert f"Node vehicle-00: its clock is 250 ms {side} of the middle of all (within 1 ms) -> synchronise it" in text


def test_a_wrong_clock_is_named_also_when_all_were_compared_with_it() -> None:
    """The first Node says 0 of itself, and all others find its clock 300 ms ahead."""
    nodes = answered("cloud-0", clock_ahead=0.0)
    for name in ("vehicle-00", "vehicle-01"):
        nodes |= {name: answered(name, clock_ahead=0.3)[name]}
    judged = probe_finding("clocks", probed(nodes=nodes))
    assert [problem.where for problem in judged.problems] == ["Node cloud-0"]
    assert "300 ms ahead of the middle" in said(judged)


def test_a_clock_that_is_known_too_roughly_is_not_known() -> None:
    judged = probe_finding("clocks", probed(nodes=answered("vehicle-00", clock_ahead=0.09, clock_within=0.05)))
    assert judged.result == NOT_CHECKED
    assert "clock of Node vehicle-00: 86 ms, known within 50 ms alone" in judged.says


def test_a_clock_that_was_not_read_is_not_known() -> None:
    judged = probe_finding("clocks", probed(nodes=answered("vehicle-00", clock_words="timed out")))
    assert (judged.result, "Node vehicle-00: timed out" in judged.says) == (NOT_CHECKED, True)


def test_an_agent_that_does_not_reach_the_broker() -> None:
    text = said(probe_finding("broker", probed(nodes=answered("vehicle-00", broker_words="timed out"))))
    assert f"Node vehicle-00: {BROKER}:8883 is not reached: timed out" in text
    assert "policy broker has to let namespace robotkube-probe in" in text


def test_a_broker_of_ones_own_that_an_agent_does_not_reach() -> None:
    elsewhere = TARGET.__class__(TARGET.namespace, IMAGE, (API,), ("mqtt.example", 8883))
    nodes = answered("vehicle-00", broker_words="No route to host")
    assert "correct broker.external" in said(probe_finding("broker", probed(nodes=nodes, target=elsewhere)))


def test_a_broker_that_is_not_installed_yet_is_not_known() -> None:
    absent = TARGET.__class__(TARGET.namespace, IMAGE, (API,), ("", 0))
    judged = probe_finding("broker", probed(target=absent), installed=False)
    assert judged.result == NOT_CHECKED
    assert "absent: the broker is the platform's own, which the chart makes" in judged.says


def test_a_network_policy_that_nobody_enforces() -> None:
    leaking = probed(nodes=answered("vehicle-00", closed=True))
    text = said(probe_finding("network-policies", leaking, settings=POLICIES))
    assert "Node vehicle-01: its pods are reached at port 8081, which a NetworkPolicy denies" in text
    assert "networkPolicies.enabled: false" in text
    judged = probe_finding("network-policies", leaking, settings=NO_POLICIES)
    assert (judged.result, "2 of 3 Nodes keep a policy; the values make none" in judged.says) == (OK, True)


def test_pods_that_do_not_reach_each_other() -> None:
    nodes = answered("vehicle-00", open_words="No route to host")
    text = said(probe_finding("network-policies", probed(nodes=nodes), settings=POLICIES))
    assert "Node vehicle-00: a pod of Node vehicle-01 is not reached at port 8080, which a policy opens" in text


def test_what_could_not_be_removed() -> None:
    text = said(probe_finding("removed", probed(left="it is still there 16 s after its deletion was asked for")))
    assert "namespace robotkube-probe: it is still there 16 s after" in text
    assert "-> kubectl delete namespace robotkube-probe" in text


def test_a_cluster_without_a_node_that_is_ready() -> None:
    nothing = Probed(TARGET, {}, {}, "", 1.0)
    assert probe_finding("disks", nothing).result == NOT_CHECKED


@pytest.mark.parametrize(("installed", "broker"), [(True, (BROKER, 8883)), (False, ("", 0))])
def test_the_target_follows_from_the_rendering(installed: bool, broker: tuple[str, int]) -> None:
    settings: dict[str, Any] = {"clusterDomain": "cluster.local"}
    target = probe_target(rendering(), settings, "robotkube-probe", installed=installed)
    assert (target.image, target.broker) == (IMAGE, broker)
    assert list(target.names) == [API, *filter(None, broker[:1])]
