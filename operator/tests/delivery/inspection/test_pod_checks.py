"""What is strange on a node, and what is not."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from robotkube.delivery.inspection.core.permitted import ReleaseShape
from robotkube.delivery.inspection.core.pod_checks import strangers_on
from robotkube.delivery.inspection.core.strangers import Stranger
from tests.stages.delivery.inspection.inspected_node import (
    CHART,
    FOREIGN,
    FOREIGN_IMAGE,
    IMAGE,
    NOW,
    PLATFORM_IMAGE,
    RENDERED,
    VERIFIED,
    permitted,
    pod_object,
    pods,
    running,
)

KNOWN: dict[str, frozenset[str]] = {}


def _seen(*objects: dict[str, Any], runs: Any = (), known: Any = KNOWN, **changes: Any) -> tuple[Stranger, ...]:
    return strangers_on(pods(*objects), running(*runs), known, permitted(**changes), NOW)


def _reasons(strangers: tuple[Stranger, ...]) -> list[str]:
    return [stranger.reason for stranger in strangers]


def test_a_pod_of_a_release_is_none() -> None:
    assert not _seen(pod_object(), runs=[("u1", "detector-5d9c7b-x", {"detector": VERIFIED})])


def test_an_image_that_is_not_listed_is_named_with_its_digest() -> None:
    of_image, of_chart = _seen(pod_object(image=FOREIGN_IMAGE))
    assert (of_image.reason, of_image.container, of_image.digest) == ("ForeignImage", "detector", FOREIGN)
    assert f"runs image {FOREIGN_IMAGE}, which is not listed for this namespace" in of_image.message
    assert of_chart.reason == "NotOfTheChart"


def test_an_image_by_tag_is_named() -> None:
    assert "ForeignImage" in _reasons(_seen(pod_object(image="forge.example/robotkube/ros:1")))


def test_an_image_that_left_the_list_a_moment_ago_is_none() -> None:
    from robotkube.registry.admission.core.allowed import Allowed

    assert not _seen(pod_object(), allowed=Allowed((), (), (CHART,)), lately=frozenset([VERIFIED]))


def test_what_the_runtime_runs_counts_not_only_what_the_pod_names() -> None:
    status = {
        "containerStatuses": [{"name": "detector", "imageID": f"r.example/x@{FOREIGN}", "state": {"running": {}}}]
    }
    (one,) = _seen(pod_object(status=status))
    assert (one.reason, one.digest) == ("ForeignImage", FOREIGN)
    status["containerStatuses"][0]["imageID"] = f"elsewhere.example/same@{VERIFIED}"
    assert not _seen(pod_object(status=status))
    status["containerStatuses"][0]["imageID"] = FOREIGN  # a runtime that knows no digest by which it was named
    assert not _seen(pod_object(status=status))


def test_an_image_volume_counts() -> None:
    volumes = [{"name": "v", "image": {"reference": FOREIGN_IMAGE}}]
    assert "ForeignImage" in _reasons(_seen(pod_object(spec={"volumes": volumes})))


@pytest.mark.parametrize("source", ["file", "http"])
def test_a_static_pod_is_named_wherever_it_is(source: str) -> None:
    (one,) = _seen(pod_object("default", annotations={"kubernetes.io/config.source": source}))
    assert (one.kind, one.reason) == ("StaticPod", "StaticPod")


def test_static_pods_of_a_control_plane_are_none_where_the_cluster_is_not_ours() -> None:
    of_cluster = pod_object("kube-system", annotations={"kubernetes.io/config.source": "file"})
    assert not _seen(of_cluster)
    assert _reasons(_seen(of_cluster, elsewhere=True)) == ["StaticPod"]


@pytest.mark.parametrize(
    "changes",
    [{"owner": ("", "")}, {"owner": ("ReplicaSet", "other-5d9c7b")}, {"owner": ("StatefulSet", "detector")}],
)
def test_a_pod_of_no_release_is_named(changes: dict[str, Any]) -> None:
    (one,) = _seen(pod_object(**changes))
    assert one.reason == "NoRelease"


def test_a_pod_that_differs_from_its_chart_is_named() -> None:
    changed = pod_object()
    changed["spec"]["containers"].append({"name": "extra", "image": IMAGE})
    (one,) = _seen(changed)
    assert one.reason == "NotOfTheChart"
    assert "extra added" in one.message
    for key, value in {"command": ["sh"], "securityContext": {"runAsUser": 0}, "env": []}.items():
        changed = pod_object()
        changed["spec"]["containers"][0][key] = value
        assert _reasons(_seen(changed)) == ["NotOfTheChart"], key


@pytest.mark.parametrize("namespace", ["vehicle-00", "robotkube", "robotkube-suite-0", "argocd", "default"])
def test_a_way_to_the_machine_is_named(namespace: str) -> None:
    ways: list[tuple[dict[str, Any], str]] = [
        ({"hostNetwork": True}, "hostNetwork"),
        ({"volumes": [{"name": "root", "hostPath": {"path": "/"}}]}, "hostPath /"),
        ({"volumes": [{"name": "share", "nfs": {"server": "files", "path": "/"}}]}, "volume share (nfs)"),
    ]
    for spec, words in ways:
        seen = _seen(pod_object(namespace, spec=spec), elsewhere=True)
        assert [one.message for one in seen if one.reason == "WayToTheMachine" and words in one.message], words
    privileged = pod_object(namespace)
    privileged["spec"]["containers"][0]["securityContext"] = {
        "privileged": True,
        "procMount": "Unmasked",
        "capabilities": {"add": ["SYS_ADMIN"]},
    }
    seen = _seen(privileged, elsewhere=True)
    (one,) = [one for one in seen if one.reason == "WayToTheMachine"]
    words = ("container detector is privileged", "container detector has procMount Unmasked")
    assert ", ".join([*words, "container detector has SYS_ADMIN"]) in one.message


def test_a_capability_that_restricted_pods_may_have_is_none() -> None:
    bound = pod_object("robotkube", owner=("ReplicaSet", "x-1"), image=PLATFORM_IMAGE)
    bound["spec"]["containers"][0]["securityContext"] = {"capabilities": {"add": ["NET_BIND_SERVICE"]}}
    assert not _seen(bound)


def test_volumes_that_restricted_pods_may_have_are_none() -> None:
    kinds = ({"emptyDir": {}}, {"persistentVolumeClaim": {"claimName": "data"}}, {"secret": {"secretName": "a"}})
    volumes = [{"name": f"volume-{number}", **kind} for number, kind in enumerate(kinds)]
    spec = {"volumes": volumes}
    assert not _seen(pod_object("robotkube", owner=("ReplicaSet", "x-1"), image=PLATFORM_IMAGE, spec=spec))


def test_a_pod_as_main_had_it_before_is_none() -> None:
    later = copy.deepcopy(dict(RENDERED))
    later["spec"]["template"]["spec"]["containers"][0]["command"] = ["other"]
    shape = ReleaseShape("detector", CHART, {"detector": later}, [{"detector": RENDERED}])
    assert not _seen(pod_object(), releases={"vehicle-00": [shape]})


def test_a_release_that_cannot_be_rendered_now_leaves_images_and_names() -> None:
    shape = ReleaseShape("detector", CHART, {}, unknown="the OCI registry is away")
    assert not _seen(pod_object(), releases={"vehicle-00": [shape]})
    assert _reasons(_seen(pod_object(image=FOREIGN_IMAGE), releases={"vehicle-00": [shape]})) == ["ForeignImage"]


def test_a_container_added_to_a_running_pod_is_named() -> None:
    added = [{"name": "debugger", "image": IMAGE}]
    (one,) = _seen(pod_object(spec={"ephemeralContainers": added}))
    assert (one.reason, one.container) == ("ForeignContainer", "debugger")
    assert "kubectl debug" in one.message


def test_a_pod_that_ends_is_none_for_as_long_as_it_may_take() -> None:
    ending = {"deletionTimestamp": "1970-01-12T13:46:30Z", "deletionGracePeriodSeconds": 30}
    assert not _seen(pod_object(image=FOREIGN_IMAGE, metadata=ending))
    overdue = {**ending, "deletionTimestamp": "1970-01-12T13:40:00Z"}
    assert _seen(pod_object(image=FOREIGN_IMAGE, metadata=overdue))
    endless = {**ending, "deletionGracePeriodSeconds": 86400}
    assert _seen(pod_object(image=FOREIGN_IMAGE, metadata=endless))


@pytest.mark.parametrize("phase", ["Succeeded", "Failed"])
def test_a_pod_that_has_ended_is_none_unless_something_of_it_runs(phase: str) -> None:
    ended = pod_object(image=FOREIGN_IMAGE, status={"phase": phase})
    assert not _seen(ended)
    assert _seen(ended, runs=[("u1", "detector-5d9c7b-x", {"detector": FOREIGN})])


def test_what_the_runtime_has_and_the_pod_does_not_name() -> None:
    runs = [("u1", "detector-5d9c7b-x", {"detector": VERIFIED, "miner": FOREIGN})]
    (one,) = _seen(pod_object(), runs=runs)
    assert (one.kind, one.reason, one.container) == ("Container", "ForeignContainer", "miner")
    assert "container miner runs in pod vehicle-00/detector-5d9c7b-x, which does not name it" in one.message


def test_a_container_that_runs_twice_is_named() -> None:
    document = running(("u1", "detector-5d9c7b-x", {"detector": VERIFIED}))
    doubled = [type(item)(item.uid, item.namespace, item.name, item.containers * 2) for item in document]
    (one,) = strangers_on(pods(pod_object()), doubled, {}, permitted(), NOW)
    assert (one.reason, one.container) == ("ForeignContainer", "detector")


def test_a_pod_that_the_kubelet_does_not_know_is_named_unless_it_knew_it_lately() -> None:
    runs = [("gone", "detector-old", {"detector": VERIFIED})]
    (one,) = _seen(pod_object(), runs=runs)
    assert (one.reason, one.name) == ("ForeignPod", "detector-old")
    assert not _seen(pod_object(), runs=runs, known={"gone": frozenset(["detector"])})
    assert _seen(pod_object(), runs=runs, known={"gone": frozenset(["other"])})
    assert not _seen(pod_object(), runs=[("gone", "detector-old", {})])


@pytest.mark.parametrize(
    ("namespace", "elsewhere", "expected"),
    [
        ("robotkube", False, ["ForeignImage", "NoController"]),
        ("robotkube-gate", False, ["ForeignImage", "NoController"]),
        ("argocd", True, ["ForeignImage", "NoController"]),
        ("argocd", False, []),
        ("robotkube-suite-0", False, []),
        ("default", True, []),  # an image of either list, by anybody
        ("default", False, []),
    ],
)
def test_other_namespaces(namespace: str, elsewhere: bool, expected: list[str]) -> None:
    assert sorted(_reasons(_seen(pod_object(namespace, owner=("", "")), elsewhere=elsewhere))) == expected


def test_pods_of_the_platform_and_of_its_jobs_are_none() -> None:
    for owner in [("ReplicaSet", "gate-1"), ("Job", "bootstrap"), ("StatefulSet", "forge")]:
        for namespace in ("robotkube", "robotkube-gate"):
            assert not _seen(pod_object(namespace, owner=owner, image=PLATFORM_IMAGE))


def test_an_image_of_the_platform_without_a_digest_is_known_by_its_name() -> None:
    tagged = pod_object("robotkube", image="docker.io/library/mongo:8.0.16")
    assert _reasons(_seen(tagged)) == ["ForeignImage"]
    assert not _seen(tagged, installed=frozenset(["docker.io/library/mongo:8.0.16"]))


def test_test_namespaces_take_any_image_by_digest() -> None:
    assert not _seen(pod_object("robotkube-suite-0", image=FOREIGN_IMAGE))
    assert _reasons(_seen(pod_object("robotkube-suite-0", image="x.example/y:1"))) == ["ForeignImage"]
