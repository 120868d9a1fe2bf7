"""What the nodes' place says of attacks, in the words of the table (ci/attacks/table.py): each has passed selection,
gate and admission here, or never met them."""

from __future__ import annotations

from typing import Any

from robotkube.delivery.inspection.core.pod_checks import strangers_on
from robotkube.delivery.inspection.core.workload_checks import strangers_among
from robotkube.registry.admission.core.allowed import Allowed
from tests.stages.attacks import shown
from tests.stages.delivery.inspection.inspected_node import (
    FOREIGN,
    FOREIGN_IMAGE,
    IMAGE,
    NOW,
    OF_PLATFORM,
    VERIFIED,
    deployment,
    permitted,
    pod_object,
    pods,
    running,
)


def _words(reason: str, item: dict[str, Any], runs: Any = (), **changes: Any) -> str:
    """The message of the one stranger of that reason on a node with this pod."""
    strangers = strangers_on(pods(item), running(*runs), {}, permitted(**changes), NOW)
    (message,) = [stranger.message for stranger in strangers if stranger.reason == reason]
    return message


def test_a_pod_with_an_image_that_is_not_listed() -> None:
    """However it came to main: the list is that of signed versions."""
    text = _words("ForeignImage", pod_object(image=FOREIGN_IMAGE))
    shown("nodes", text, "image-by-manager", "image-by-publisher", "merge-against-the-gate")


def test_an_image_as_a_volume() -> None:
    volumes = [{"name": "v", "image": {"reference": FOREIGN_IMAGE}}]
    shown("nodes", _words("ForeignImage", pod_object(spec={"volumes": volumes})), "image-volume")


def test_a_tag_that_has_moved() -> None:
    """A node's runtime was told other bytes under the name that the pod has."""
    status = {
        "containerStatuses": [{"name": "detector", "imageID": f"x.example/y@{FOREIGN}", "state": {"running": {}}}]
    }
    shown("nodes", _words("ForeignImage", pod_object(status=status)), "tag-moves")


def test_an_image_that_was_pushed_to_the_platforms_organisation() -> None:
    foreign = pod_object("robotkube", image=f"forge.example/robotkube/platform@{FOREIGN}", owner=("Job", "x"))
    shown("nodes", _words("ForeignImage", foreign), "platform-image-pushed")


def test_a_way_to_the_machine() -> None:
    """Also when the release's chart renders it, from a parameter."""
    volumes = [{"name": "root", "hostPath": {"path": "/"}}]
    text = _words("WayToTheMachine", pod_object(spec={"volumes": volumes}))
    shown("nodes", text, "way-to-the-machine", "application-to-the-machine")


def test_a_release_of_a_chart_that_is_not_verified() -> None:
    """Called verified by an entry without the gate's signature, withdrawn, or put on main past the gate."""
    (one,) = strangers_among(deployment(), "Deployment", permitted(allowed=Allowed((VERIFIED,), (OF_PLATFORM,))))
    shown("nodes", one.message, "entry-called-verified", "status-forged", "withdrawn-version")
    shown("nodes", one.message, "main-moved-past-the-gate", "break-glass-claimed")


def test_a_workload_that_main_does_not_have() -> None:
    """Argo CD was told to apply it, by an Application or an operation of somebody's own, or somebody spoke for it."""
    (one,) = strangers_among(deployment(), "Deployment", permitted(releases={}))
    shown("nodes", one.message, "application-by-argocd", "operation-with-source", "controller-impersonated")


def test_a_pod_of_no_release() -> None:
    shown("nodes", _words("NoRelease", pod_object(owner=("", ""))), "pod-by-administrator")


def test_a_container_added_to_a_pod_that_runs() -> None:
    added = {"ephemeralContainers": [{"name": "debugger", "image": IMAGE}]}
    shown("nodes", _words("ForeignContainer", pod_object(spec=added)), "ephemeral-container")


def test_a_container_that_the_runtime_was_told_to_put_into_a_pod() -> None:
    """By the runtime's own interface for kubelets, in the sandbox of a pod that runs."""
    text = _words("ForeignContainer", pod_object(), [("u1", "detector-5d9c7b-x", {"detector": IMAGE, "miner": IMAGE})])
    shown("nodes", text, "container-into-a-pod")


def test_a_static_pod() -> None:
    text = _words("StaticPod", pod_object(annotations={"kubernetes.io/config.source": "file"}))
    shown("nodes", text, "static-pod")


def test_a_pod_that_was_changed_as_it_was_made() -> None:
    """By a mutating policy or webhook: its Deployment is as the chart renders it."""
    item = pod_object()
    item["spec"]["volumes"].append({"name": "script", "configMap": {"name": "script", "defaultMode": 420}})
    item["spec"]["containers"][0]["livenessProbe"] = {"exec": {"command": ["sh", "/script/run"]}}
    shown("nodes", _words("NotOfTheChart", item), "pod-changed-as-made")


def test_a_pod_that_was_resized() -> None:
    item = pod_object()
    item["spec"]["containers"][0]["resources"] = {"limits": {"memory": "3Gi"}}
    shown("nodes", _words("NotOfTheChart", item), "pod-resized")
