"""A pod that is not its workload's template is named, whatever of it differs; what is written into each pod is not."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import pytest

from robotkube.delivery.inspection.core.permitted import ReleaseShape
from robotkube.delivery.inspection.core.pod_checks import strangers_on
from robotkube.delivery.inspection.core.pod_templates import LIMIT_RANGER, TOKEN, TOKEN_PATH, TOLERATIONS
from tests.stages.delivery.inspection.inspected_node import CHART, IMAGE, NOW, RENDERED, permitted, pod_object, pods

Object = dict[str, Any]
SCRIPT = {"exec": {"command": ["sh", "/script/run"]}}
MOUNT = {"name": "script", "mountPath": "/usr/bin/robotkube-event-detector", "subPath": "run"}
VOLUME = {"name": "script", "configMap": {"name": "script", "defaultMode": 420}}
TOKEN_MOUNT = {"name": "kube-api-access-x7d2p", "mountPath": TOKEN_PATH, "readOnly": True}


def messages(pod: Object, template: Object | None = None) -> list[str]:
    """What is said of a pod of the detector, whose chart renders `template`."""
    workload = copy.deepcopy(dict(RENDERED))
    if template is not None:
        workload["spec"]["template"] = template
    shape = ReleaseShape("detector", CHART, {"detector": workload})
    listed = strangers_on(pods(pod), (), {}, permitted(releases={"vehicle-00": [shape]}), NOW)
    assert {one.reason for one in listed} <= {"NotOfTheChart"}
    return [one.message for one in listed]


def template() -> Object:
    return copy.deepcopy(RENDERED["spec"]["template"])


def first(pod: Object) -> Object:
    """The pod's container."""
    container: Object = pod["spec"]["containers"][0]
    return container


CHANGES: dict[str, Callable[[Object], Any]] = {
    "a probe that runs a script": lambda pod: first(pod)["livenessProbe"].update(SCRIPT),
    "a probe more": lambda pod: first(pod).update(startupProbe=SCRIPT),
    "a hook": lambda pod: first(pod).update(lifecycle={"postStart": SCRIPT}),
    "a mount over the program": lambda pod: first(pod).update(volumeMounts=[MOUNT]),
    "a volume": lambda pod: pod["spec"]["volumes"].append(VOLUME),
    "another ConfigMap": lambda pod: pod["spec"]["volumes"][0]["configMap"].update(name="other"),
    "a device": lambda pod: first(pod).update(volumeDevices=[{"name": "settings", "devicePath": "/dev/x"}]),
    "a command": lambda pod: first(pod).update(command=["sh"]),
    "arguments": lambda pod: first(pod).update(args=["-x"]),
    "a folder": lambda pod: first(pod).update(workingDir="/elsewhere"),
    "a variable": lambda pod: first(pod)["env"].append({"name": "LD_PRELOAD", "value": "/script/x.so"}),
    "variables of a ConfigMap": lambda pod: first(pod).update(envFrom=[{"configMapRef": {"name": "x"}}]),
    "rights": lambda pod: first(pod).update(securityContext={"runAsUser": 0}),
    "rights of the pod": lambda pod: pod["spec"].update(securityContext={"runAsUser": 0}),
    "a port": lambda pod: first(pod).update(ports=[{"containerPort": 22, "protocol": "TCP"}]),
    "resources": lambda pod: first(pod)["resources"]["requests"].update(cpu="4"),
    "a terminal": lambda pod: first(pod).update(stdin=True, tty=True),
    "an account": lambda pod: pod["spec"].update(serviceAccountName="gate", serviceAccount="gate"),
    "names of hosts": lambda pod: pod["spec"].update(hostAliases=[{"ip": "10.0.0.9", "hostnames": ["broker"]}]),
    "name servers": lambda pod: pod["spec"].update(dnsPolicy="None", dnsConfig={"nameservers": ["10.0.0.9"]}),
    "one namespace for all processes": lambda pod: pod["spec"].update(shareProcessNamespace=True),
    "another runtime": lambda pod: pod["spec"].update(runtimeClassName="other"),
    "a container before": lambda pod: pod["spec"].update(initContainers=[{"name": "first", "image": IMAGE}]),
    "a label": lambda pod: pod["metadata"]["labels"].update(role="broker"),
    "a label less": lambda pod: pod["metadata"].update(labels={}),
    "an annotation": lambda pod: pod["metadata"]["annotations"].update({"example.com/note": "x"}),
    "a toleration": lambda pod: pod["spec"].update(tolerations=[{"operator": "Exists"}]),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_whatever_of_a_pod_its_template_does_not_have_is_named(change: Callable[[Object], Any]) -> None:
    changed = pod_object()
    change(changed)
    assert len(messages(changed)) == 1


def given(pod: Object) -> Object:
    """The pod with what is written into each."""
    pod["metadata"]["labels"] |= {"pod-template-hash": "5d9c7b", "topology.kubernetes.io/zone": "a"}
    pod["metadata"]["annotations"] |= {"kubernetes.io/config.seen": "t", "cni.projectcalico.org/podIP": "10.0.0.1/32"}
    pod["spec"] |= {
        "priority": 0,
        "preemptionPolicy": "PreemptLowerPriority",
        "imagePullSecrets": [{"name": "pull"}],
        "tolerations": [dict(one) for one in TOLERATIONS],
    }
    pod["spec"]["volumes"].append({"name": TOKEN_MOUNT["name"], "projected": copy.deepcopy(TOKEN)})
    first(pod).setdefault("volumeMounts", []).append(dict(TOKEN_MOUNT))
    return pod


def test_what_is_written_into_each_pod_is_none() -> None:
    assert not messages(given(pod_object()))


def test_a_token_is_named_where_the_template_wants_none() -> None:
    wanted = template()
    wanted["spec"]["automountServiceAccountToken"] = False
    (text,) = messages(given(pod_object(spec={"automountServiceAccountToken": False})), wanted)
    assert "kube-api-access-x7d2p added" in text


def test_a_volume_that_only_has_the_name_of_the_token_is_named() -> None:
    pod = given(pod_object())
    pod["spec"]["volumes"][-1] = {"name": TOKEN_MOUNT["name"], "secret": {"secretName": "hooks", "defaultMode": 420}}
    assert len(messages(pod)) == 1


def test_the_token_mounted_elsewhere_is_named() -> None:
    pod = given(pod_object())
    first(pod)["volumeMounts"][-1]["mountPath"] = "/elsewhere"
    assert len(messages(pod)) == 1


def test_limits_are_requested_where_the_template_says_nothing() -> None:
    wanted = template()
    wanted["spec"]["containers"][0]["resources"] = {"limits": {"memory": "1024Mi"}}
    pod = pod_object()
    first(pod)["resources"] = {"limits": {"memory": "1Gi"}, "requests": {"memory": "1Gi"}}
    assert not messages(pod, wanted)


def test_amounts_of_the_namespaces_limits_are_none() -> None:
    pod = pod_object(annotations={LIMIT_RANGER: "LimitRanger plugin set: memory limit for container detector"})
    first(pod)["resources"]["limits"] = {"memory": "1Gi"}
    assert not messages(pod)
    first(pod)["resources"]["requests"]["memory"] = "4Gi"
    assert len(messages(pod)) == 1
