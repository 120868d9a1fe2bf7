"""Images in rendered objects: of every kind of container, in every kind of workload."""

from typing import Any

import pytest

from robotkube.registry.charts.core.pod_images import DEPTH_MAX, pod_images

ONE, TWO = "forge:3000/robotkube/ros@sha256:1", "docker.io/library/busybox:latest"


def pod(**parts: Any) -> dict[str, Any]:
    return {"containers": [{"name": "app", "image": ONE}], **parts}


PLACES: dict[str, dict[str, Any]] = {
    "a container": {"kind": "Pod", "spec": pod(containers=[{"name": "app", "image": TWO}])},
    "an init container": {"kind": "Pod", "spec": pod(initContainers=[{"name": "first", "image": TWO}])},
    "an ephemeral container": {"kind": "Pod", "spec": pod(ephemeralContainers=[{"name": "debug", "image": TWO}])},
    "a volume that is an image": {"kind": "Pod", "spec": pod(volumes=[{"name": "v", "image": {"reference": TWO}}])},
    "a sidecar": {
        "kind": "Deployment",
        "spec": {"template": {"spec": pod(containers=[{"image": ONE}, {"image": TWO}])}},
    },
    "a job of a CronJob": {
        "kind": "CronJob",
        "spec": {"jobTemplate": {"spec": {"template": {"spec": pod(initContainers=[{"image": TWO}])}}}},
    },
    "a list of objects": {"kind": "List", "items": [{"kind": "Pod", "spec": pod(containers=[{"image": TWO}])}]},
    "a kind that nobody knows": {
        "kind": "Rollout",
        "spec": {"workload": {"podSpec": pod(containers=[{"image": TWO}])}},
    },
}


@pytest.mark.parametrize("place", PLACES)
def test_images_are_seen_in(place: str) -> None:
    assert TWO in pod_images([PLACES[place]])


def test_each_image_is_named_once_and_one_that_is_missing_as_none() -> None:
    assert pod_images([{"spec": pod()}, {"spec": pod(initContainers=[{"name": "no image"}])}]) == ("", ONE)


def test_what_only_looks_like_an_image_is_none() -> None:
    assert pod_images([{"kind": "ConfigMap", "data": {"config.yaml": "containers: [{image: x}]", "image": TWO}}]) == ()
    assert pod_images([{"containers": "x", "volumes": ["y"], "initContainers": {"image": TWO}}]) == ()


def test_depth_has_a_bound() -> None:
    nested: dict[str, Any] = {"spec": pod()}
    for _ in range(DEPTH_MAX):
        nested = {"inner": nested}
    assert pod_images([nested]) == ()
