"""Workloads of releases compared with what their charts render."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from robotkube.delivery.inspection.core.comparison import differences
from robotkube.delivery.inspection.core.permitted import ReleaseShape
from robotkube.delivery.inspection.core.workload_checks import strangers_among
from robotkube.registry.admission.core.allowed import Allowed
from tests.stages.delivery.inspection.inspected_node import CHART, IMAGE, RENDERED, VERIFIED, deployment, permitted


def _changed(path: str, value: Any) -> dict[str, Any]:
    """The Deployment with a value put at a path of keys and numbers."""
    item = deployment()
    place: Any = item
    *way, last = path.split("/")
    for word in way:
        place = place[int(word)] if isinstance(place, list) else place.setdefault(word, {})
    if isinstance(place, list):
        place.append(value)
    else:
        place[last] = value
    return item


def test_as_the_api_server_has_it() -> None:
    assert differences(deployment(), RENDERED) == ()
    assert not list(strangers_among(deployment(), "Deployment", permitted()))


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("spec/template/spec/containers/-", {"name": "miner", "image": IMAGE}, "has 2 entries, not 1 (miner added)"),
        ("spec/template/spec/initContainers", [{"name": "i"}], "initContainers is"),
        ("spec/template/spec/containers/0/image", "x", "containers[detector].image is x, not"),
        ("spec/template/spec/containers/0/command", ["sh"], "command[sh] is sh, not robotkube-event-detector"),
        ("spec/template/spec/containers/0/env/-", {"name": "LD_PRELOAD", "value": "x"}, "LD_PRELOAD added"),
        ("spec/template/spec/volumes/-", {"name": "root", "hostPath": {"path": "/"}}, "root added"),
        ("spec/template/spec/hostNetwork", True, "hostNetwork is True, which the chart does not have"),
        ("spec/template/spec/containers/0/imagePullPolicy", "Always", "imagePullPolicy is Always"),
        ("spec/template/spec/containers/0/livenessProbe/periodSeconds", 5, "periodSeconds is 5"),
        ("spec/template/metadata/annotations", {"kubectl.kubernetes.io/restartedAt": "2026"}, "annotations"),
        ("spec/template/metadata/labels/team", "x", "labels.team is x, which the chart does not have"),
        ("metadata/annotations/team", "x", "metadata.annotations.team is x, which the chart does not have"),
        ("metadata/labels/team", "x", "metadata.labels.team is x"),
        ("metadata/annotations/example.com", "", "metadata.annotations.example.com is , which the chart does not have"),
        ("spec/strategy/type", "RollingUpdate", "strategy.type is RollingUpdate, not Recreate"),
        ("spec/paused", True, "spec.paused is True"),
        ("spec/template/spec/containers/0/resources/requests/cpu", "2", "cpu is 2, not 1000m"),
    ],
)
def test_a_change_is_named_with_its_place(path: str, value: Any, words: str) -> None:
    (one,) = strangers_among(_changed(path, value), "Deployment", permitted())
    assert one.reason == "NotOfTheChart"
    assert words in one.message


def test_what_was_taken_away_is_named() -> None:
    item = deployment()
    del item["spec"]["template"]["spec"]["containers"][0]["resources"]["requests"]["memory"]
    (one,) = strangers_among(item, "Deployment", permitted())
    assert "requests.memory is missing" in one.message


def test_how_many_pods_run_is_not_compared() -> None:
    assert not list(strangers_among(_changed("spec/replicas", 3), "Deployment", permitted()))


def test_what_is_being_deleted_is_none() -> None:
    item = _changed("metadata/deletionTimestamp", "2026-01-01T00:00:00Z")
    assert not list(strangers_among(item, "Deployment", permitted(releases={})))


def test_a_workload_of_no_release_is_named() -> None:
    (one,) = strangers_among(deployment(), "Deployment", permitted(releases={}))
    assert one.reason == "NoRelease"
    (one,) = strangers_among(deployment(), "DaemonSet", permitted())
    assert (one.kind, one.reason) == ("DaemonSet", "NoRelease")


def test_what_a_workload_makes_is_judged_with_it() -> None:
    owner = [{"kind": "Deployment", "name": "detector", "controller": True}]
    assert not list(strangers_among(_changed("metadata/ownerReferences", owner), "ReplicaSet", permitted()))
    assert list(strangers_among(_changed("metadata/ownerReferences", owner), "StatefulSet", permitted()))


def test_as_main_had_it_before_it_is_none() -> None:
    """Argo CD applies what main says a moment later, and rolls out for minutes."""
    later = copy.deepcopy(dict(RENDERED))
    later["spec"]["template"]["spec"]["containers"][0]["command"] = ["other"]
    shape = ReleaseShape("detector", CHART, {"detector": later}, [{"detector": RENDERED}])
    assert not list(strangers_among(deployment(), "Deployment", permitted(releases={"vehicle-00": [shape]})))
    (one,) = strangers_among(
        _changed("metadata/labels/team", "x"), "Deployment", permitted(releases={"vehicle-00": [shape]})
    )
    assert one.reason == "NotOfTheChart"


def test_a_chart_that_is_not_verified_is_named_unless_it_was_a_moment_ago() -> None:
    allowed = Allowed((VERIFIED,))
    (one,) = strangers_among(deployment(), "Deployment", permitted(allowed=allowed))
    assert one.reason == "ForeignChart"
    assert not list(strangers_among(deployment(), "Deployment", permitted(allowed=allowed, lately=frozenset([CHART]))))


def test_what_cannot_be_rendered_now_is_not_judged() -> None:
    shape = ReleaseShape("detector", CHART, {}, unknown="the OCI registry is away")
    assert not list(strangers_among(deployment(), "Deployment", permitted(releases={"vehicle-00": [shape]})))
