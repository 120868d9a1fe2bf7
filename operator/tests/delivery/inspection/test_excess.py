"""Which parts of a workload its chart does not render: exactly what has to go, and nothing of the API server's."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from robotkube.delivery.inspection.core.excess import EXCESS_MAX, excess

TEMPLATE = "/spec/template/spec"


def rendered() -> dict[str, Any]:
    container = {
        "name": "main",
        "image": "a@sha256:1",
        "env": [{"name": "A", "value": "1"}],
        "args": ["--one"],
        "volumeMounts": [{"name": "tmp", "mountPath": "/data/a"}, {"name": "tmp", "mountPath": "/data/b"}],
        "ports": [{"name": "http", "containerPort": 8080}],
    }
    sources = [{"serviceAccountToken": {"path": "token"}}]
    spec = {
        "containers": [container],
        "volumes": [{"name": "tmp", "emptyDir": {}}, {"name": "account", "projected": {"sources": sources}}],
    }
    template = {"metadata": {"labels": {"app": "detector"}}, "spec": spec}
    selector = {"matchLabels": {"app": "detector"}}
    metadata = {"name": "detector", "labels": {"app": "detector"}}
    return copy.deepcopy({"metadata": metadata, "spec": {"replicas": 1, "selector": selector, "template": template}})


def as_served() -> dict[str, Any]:
    """As the API server has it: with defaults, and what controllers write."""
    whole = rendered()
    whole["metadata"]["annotations"] = {"deployment.kubernetes.io/revision": "3"}
    whole["spec"] |= {"revisionHistoryLimit": 10, "progressDeadlineSeconds": 600}
    spec = whole["spec"]["template"]["spec"]
    spec |= {"restartPolicy": "Always", "dnsPolicy": "ClusterFirst", "securityContext": {}}
    spec["containers"][0] |= {"terminationMessagePolicy": "File", "imagePullPolicy": "IfNotPresent", "resources": {}}
    spec["containers"][0]["ports"][0]["protocol"] = "TCP"
    spec["volumes"][1]["projected"] |= {"defaultMode": 420}
    spec["volumes"][1]["projected"]["sources"][0]["serviceAccountToken"]["expirationSeconds"] = 3600
    return whole


def test_what_the_api_server_filled_in_is_no_excess() -> None:
    assert excess(as_served(), [rendered()]) == ()


def container(whole: dict[str, Any]) -> dict[str, Any]:
    return whole["spec"]["template"]["spec"]["containers"][0]


def spec(whole: dict[str, Any]) -> dict[str, Any]:
    return whole["spec"]["template"]["spec"]


ADDED: dict[str, Any] = {
    f"{TEMPLATE}/containers/1": lambda o: spec(o)["containers"].append({"name": "side", "image": "b"}),
    f"{TEMPLATE}/containers/0": lambda o: spec(o)["containers"].insert(0, {"name": "side", "image": "b"}),
    f"{TEMPLATE}/initContainers": lambda o: spec(o).update(initContainers=[{"name": "first", "image": "b"}]),
    f"{TEMPLATE}/volumes/2": lambda o: spec(o)["volumes"].append({"name": "more", "emptyDir": {}}),
    f"{TEMPLATE}/hostNetwork": lambda o: spec(o).update(hostNetwork=True),
    f"{TEMPLATE}/containers/0/env/1": lambda o: container(o)["env"].append({"name": "B", "value": "2"}),
    f"{TEMPLATE}/containers/0/env/0": lambda o: container(o)["env"].insert(0, {"name": "A", "value": "2"}),
    f"{TEMPLATE}/containers/0/command": lambda o: container(o).update(command=["sh"]),
    f"{TEMPLATE}/containers/0/volumeMounts/2": lambda o: container(o)["volumeMounts"].append(
        {"name": "tmp", "mountPath": "/data/c"}
    ),
    f"{TEMPLATE}/containers/0/ports/1": lambda o: container(o)["ports"].append({"containerPort": 9090}),
    "/spec/template/metadata/annotations": lambda o: o["spec"]["template"]["metadata"].update(
        annotations={"note": "mine"}
    ),
    "/metadata/annotations/example.com~1a~0b": lambda o: o["metadata"]["annotations"].update({"example.com/a~b": "1"}),
    "/metadata/labels/mine": lambda o: o["metadata"]["labels"].update(mine="1"),
    "/spec/paused": lambda o: o["spec"].update(paused=True),
}


@pytest.mark.parametrize("pointer", ADDED)
def test_what_was_added_is_named_exactly(pointer: str) -> None:
    whole = as_served()
    ADDED[pointer](whole)
    assert excess(whole, [rendered()]) == (pointer,)


def test_the_same_variable_twice_is_one_too_many() -> None:
    whole = as_served()
    container(whole)["env"].append({"name": "A", "value": "1"})
    assert excess(whole, [rendered()]) == (f"{TEMPLATE}/containers/0/env/1",)


@pytest.mark.parametrize(
    "change",
    [
        lambda o: container(o).update(image="b"),
        lambda o: container(o)["args"].append("--two"),
        lambda o: container(o)["env"][0].update(value="2"),
        lambda o: o["spec"].update(replicas=5),
        lambda o: spec(o)["volumes"][1]["projected"]["sources"].append({"secret": {"name": "x"}}),
    ],
)
def test_what_is_otherwise_is_argo_cds_to_put_back(change: Any) -> None:
    whole = as_served()
    change(whole)
    assert excess(whole, [rendered()]) == ()


def test_what_one_of_the_versions_has_is_no_excess() -> None:
    """While a release is being replaced its workload may be as either of them."""
    whole = as_served()
    newer = rendered()
    spec(whole)["containers"].append({"name": "side", "image": "b"})
    spec(newer)["containers"].append({"name": "side", "image": "b"})
    whole["metadata"]["labels"]["mine"] = "1"
    assert excess(whole, [rendered(), newer]) == ("/metadata/labels/mine",)
    assert excess(whole, [newer, rendered()]) == ("/metadata/labels/mine",)
    assert excess(whole, []) == ()


def test_it_is_bounded() -> None:
    whole = as_served()
    whole["metadata"]["labels"] |= {f"l{number}": "1" for number in range(EXCESS_MAX + 9)}
    assert len(excess(whole, [rendered()])) == EXCESS_MAX
