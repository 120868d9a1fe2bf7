"""Rules of the static suite on objects and schemas, one mistake at a time; with a real chart: tests/charts."""

from __future__ import annotations

import copy
from collections.abc import Callable
from decimal import Decimal
from typing import Any

import pytest

from robotkube.foundation.documents.core.quantities import quantity, written
from robotkube.registry.charts.core import values_schemas
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.suites.core import pod_security, static_checks
from robotkube.registry.suites.core.static_checks import Rendering
from tests.stages.attacks import shown
from tests.stages.paths import DOCS

IMAGE = "forge.invalid:3000/robotkube/ros@sha256:" + "5" * 64
LABELS = {"app.kubernetes.io/name": "app", "app.kubernetes.io/instance": "one", "robotkube.io/agent": "vehicle-00"}
PROBE = {"httpGet": {"path": "/readyz", "port": 8081}}
CONTAINER = {
    "name": "app",
    "image": IMAGE,
    "securityContext": {
        "allowPrivilegeEscalation": False,
        "readOnlyRootFilesystem": True,
        "capabilities": {"drop": ["ALL"]},
    },
    "resources": {"requests": {"cpu": "30m", "memory": "64Mi"}, "limits": {"memory": "256Mi"}},
    "startupProbe": PROBE,
    "readinessProbe": PROBE,
    "livenessProbe": PROBE,
}
POD = {
    "serviceAccountName": "application",
    "nodeSelector": {"robotkube.io/agent": "vehicle-00"},
    "securityContext": {"runAsNonRoot": True, "runAsUser": 10001, "seccompProfile": {"type": "RuntimeDefault"}},
    "containers": [CONTAINER],
    "volumes": [{"name": "tmp", "emptyDir": {}}, {"name": "settings", "configMap": {"name": "one"}}],
}
DEPLOYMENT = {
    "apiVersion": "apps/v1",
    "kind": "Deployment",
    "metadata": {"name": "one", "labels": LABELS},
    "spec": {
        "replicas": 1,
        "strategy": {"type": "Recreate"},
        "template": {"metadata": {"labels": LABELS}, "spec": POD},
    },
}
SETTINGS = {"apiVersion": "v1", "kind": "ConfigMap", "metadata": {"name": "one", "labels": LABELS}}

Change = Callable[[dict[str, Any], dict[str, Any], dict[str, Any]], Any]


def rendering(change: Change = lambda deployment, pod, container: None, *more: dict[str, Any]) -> Rendering:
    deployment = copy.deepcopy(DEPLOYMENT)
    pod: dict[str, Any] = deployment["spec"]["template"]["spec"]  # type: ignore[index]
    change(deployment, pod, pod["containers"][0])
    return Rendering("first", "app", "one", "vehicle-00", [deployment, SETTINGS, *more])


def failed(*renderings: Rendering) -> dict[str, Check]:
    return {check.name: check for check in static_checks.object_checks(renderings) if not check.passed}


def test_objects_in_order_pass_every_rule() -> None:
    checks = static_checks.object_checks([rendering()])
    assert [check for check in checks if not check.passed or check.found] == []
    assert len(checks) == len(static_checks.RULES) + len(pod_security.RULES) + 1


def test_every_check_is_explained() -> None:
    page = (DOCS / "reference" / "suites-static.md").read_text(encoding="utf-8")
    names = [check.name.removeprefix("pod-security/") for check in static_checks.object_checks([rendering()])]
    assert [name for name in names if f"| `{name}` |" not in page] == []


def context(**values: Any) -> Change:
    return lambda deployment, pod, container: container["securityContext"].update(values)


def pod_context(**values: Any) -> Change:
    return lambda deployment, pod, container: pod["securityContext"].update(values)


def of_pod(**values: Any) -> Change:
    return lambda deployment, pod, container: pod.update(values)


def of_container(**values: Any) -> Change:
    return lambda deployment, pod, container: container.update(values)


def annotated(deployment: Any, pod: Any, container: Any) -> None:
    deployment["spec"]["template"]["metadata"]["annotations"] = {
        "container.apparmor.security.beta.kubernetes.io/app": "unconfined"
    }


def second_container(**values: Any) -> Change:
    return lambda deployment, pod, container: pod["containers"].append({**CONTAINER, "name": "second", **values})


SECURITY: dict[str, list[tuple[Change, str]]] = {
    "host-namespaces": [
        (of_pod(hostNetwork=True), "Deployment one: hostNetwork is true"),
        (of_pod(hostPID=True), "hostPID is true"),
        (of_pod(hostIPC=True), "hostIPC is true"),
    ],
    "privileged": [(context(privileged=True), "Deployment one: container app: privileged is true")],
    "host-process": [(pod_context(windowsOptions={"hostProcess": True}), "pod: windowsOptions.hostProcess")],
    "host-ports": [(of_container(ports=[{"containerPort": 1, "hostPort": 80}]), "hostPort 80")],
    "host-probes": [
        (of_container(livenessProbe={"httpGet": {"host": "10.0.0.1"}}), "livenessProbe.httpGet.host"),
        (of_container(lifecycle={"preStop": {"tcpSocket": {"host": "x"}}}), "preStop.tcpSocket.host"),
    ],
    "volume-types": [
        (of_pod(volumes=[{"name": "node", "hostPath": {"path": "/"}}]), "volume node: type hostPath: a folder of the"),
        (of_pod(volumes=[{"name": "share", "nfs": {}}]), "volume share: type nfs"),
    ],
    "proc-mount": [(context(procMount="Unmasked"), "procMount is 'Unmasked'")],
    "sysctls": [(pod_context(sysctls=[{"name": "kernel.msgmax", "value": "1"}]), "sysctl kernel.msgmax")],
    "apparmor": [
        (annotated, "annotation container.apparmor.security.beta.kubernetes.io/app is 'unconfined'"),
        (context(appArmorProfile={"type": "Unconfined"}), "appArmorProfile.type is 'Unconfined'"),
    ],
    "selinux": [
        (context(seLinuxOptions={"type": "spc_t"}), "seLinuxOptions.type is 'spc_t'"),
        (pod_context(seLinuxOptions={"user": "root"}), "pod: seLinuxOptions.user is 'root'"),
    ],
    "privilege-escalation": [
        (context(allowPrivilegeEscalation=True), "allowPrivilegeEscalation is not false"),
        (second_container(securityContext={"capabilities": {"drop": ["ALL"]}}), "container second: allowPrivilege"),
    ],
    "run-as-non-root": [
        (pod_context(runAsNonRoot=None), "container app: runAsNonRoot is not true"),
        (context(runAsNonRoot=False), "container app: runAsNonRoot is not true"),
    ],
    "run-as-user": [(pod_context(runAsUser=0), "pod: runAsUser is 0"), (context(runAsUser=0), "app: runAsUser is 0")],
    "seccomp": [
        (pod_context(seccompProfile=None), "seccompProfile.type is not set"),
        (context(seccompProfile={"type": "Unconfined"}), "seccompProfile.type is Unconfined"),
    ],
    "capabilities": [
        (context(capabilities={}), "capabilities.drop does not hold ALL"),
        (context(capabilities={"drop": ["ALL"], "add": ["SYS_ADMIN", "NET_BIND_SERVICE"]}), "add holds SYS_ADMIN"),
    ],
}


def test_every_rule_of_pod_security_is_tried() -> None:
    assert set(SECURITY) == {rule.name for rule in pod_security.RULES}


@pytest.mark.parametrize("name", SECURITY)
def test_a_pod_that_breaks_pod_security(name: str) -> None:
    for change, sentence in SECURITY[name]:
        problem = failed(rendering(change))[f"pod-security/{name}"]
        assert sentence in problem.found
        assert problem.fix
        if "hostPath" in sentence:
            shown("gate", problem.found, "way-to-the-machine")


def test_containers_of_every_sort_are_looked_at() -> None:
    for kind in pod_security.CONTAINER_LISTS[1:]:
        change = of_pod(**{kind: [{**CONTAINER, "name": "other", "securityContext": {"privileged": True}}]})
        problems = failed(rendering(change))
        assert "container other: privileged" in problems["pod-security/privileged"].found
        assert "pod-security/capabilities" in problems


def test_what_may_be_set_on_the_container_alone() -> None:
    def move(deployment: Any, pod: Any, container: Any) -> None:
        container["securityContext"] |= pod.pop("securityContext")

    assert failed(rendering(move)) == {}
    assert failed(rendering(context(capabilities={"drop": ["ALL"], "add": ["NET_BIND_SERVICE"]}))) == {}


def named(name: str) -> Change:
    return lambda deployment, pod, container: deployment["metadata"].update(name=name)


def object_of(kind: str, version: str = "v1") -> dict[str, Any]:
    return {"apiVersion": version, "kind": kind, "metadata": {"name": "one", "labels": LABELS}}


@pytest.mark.parametrize(
    ("check", "broken", "found"),
    [
        ("kinds", rendering(lambda *_: None, object_of("Secret")), "Secret one (v1): Secrets are made per agent"),
        ("kinds", rendering(lambda *_: None, object_of("Role", "rbac.authorization.k8s.io/v1")), "rights are given by"),
        ("kinds", rendering(lambda *_: None, object_of("Deployment", "extensions/v1beta1")), "(extensions/v1beta1)"),
        ("kinds", rendering(lambda *_: None, object_of("Pod")), "AppProject lets no release have this kind"),
        ("kinds", Rendering("first", "app", "one", "vehicle-00", [SETTINGS]), "0 Deployments; a service is exactly"),
        ("names", rendering(named("app")), "Deployment app: is not named as the release, which was one"),
        ("names", rendering(lambda *_: None, SETTINGS), "ConfigMap one: stands twice"),
        ("names", rendering(lambda d, *_: d["metadata"].update(namespace="other")), "metadata.namespace is set"),
        ("labels", rendering(lambda d, *_: d["metadata"].update(labels={})), "label robotkube.io/agent is None"),
        ("labels", rendering(lambda d, *_: d["spec"]["template"].pop("metadata")), "pod template of Deployment one"),
        ("placement", rendering(of_pod(nodeSelector={})), "nodeSelector robotkube.io/agent is None, not 'vehicle-00'"),
        ("placement", rendering(of_pod(nodeName="node-1")), "nodeName is set"),
        ("placement", rendering(of_pod(priorityClassName="system-node-critical")), "push others off the node"),
        ("hooks", rendering(lambda d, *_: d["metadata"].update(annotations={"helm.sh/hook": "x"})), "annotation helm"),
        ("resources", rendering(of_container(resources={})), "container app: resources.requests.cpu is missing"),
        ("probes", rendering(of_container(startupProbe=None)), "container app: startupProbe is missing"),
        ("images-by-digest", rendering(of_container(image="ros:1")), "image ros:1 is not named by its digest"),
        ("images-by-digest", rendering(of_container(image=IMAGE[:-1])), "is not named by its digest"),
        ("service-account", rendering(of_pod(serviceAccountName=None)), "serviceAccountName is default"),
        ("read-only-root", rendering(context(readOnlyRootFilesystem=False)), "readOnlyRootFilesystem is not true"),
    ],
)  # fmt: skip
def test_objects_that_break_a_rule(check: str, broken: Rendering, found: str) -> None:
    problem = failed(broken)[check]
    assert found in problem.found
    assert problem.fix


def test_all_problems_are_named_each_once() -> None:
    def change(deployment: Any, pod: Any, container: Any) -> None:
        container.update(image="ros", resources={}, livenessProbe=None)

    problems = failed(rendering(change), rendering(change))
    assert set(problems) == {"images-by-digest", "resources", "probes"}
    assert problems["images-by-digest"].found.count("image ros") == 1


def test_a_long_list_of_problems_is_cut() -> None:
    cut = static_checks.check("x", [str(number) for number in range(100)], "fix").found
    assert cut.endswith(f"; {static_checks.PROBLEMS_SHOWN - 1}; and 80 more")


def test_a_pod_of_any_kind_is_looked_at() -> None:
    template = {"metadata": {}, "spec": {**POD, "hostNetwork": True}}
    for kind, spec in (
        ("DaemonSet", {"template": template}),
        ("CronJob", {"jobTemplate": {"spec": {"template": template}}}),
        ("Pod", template["spec"]),
    ):
        problems = failed(rendering(lambda *_: None, {**object_of(kind), "spec": spec}))
        assert f"{kind} one: hostNetwork" in problems["pod-security/host-namespaces"].found


@pytest.mark.parametrize(
    "value",
    [None, [], "text", 7, {"spec": "x"}, {"spec": {"template": {"spec": {"containers": "x", "volumes": [1]}}}}],
)
def test_objects_of_the_wrong_form_are_no_crash(value: Any) -> None:
    odd = {"kind": "Deployment", "metadata": value, "spec": value}
    assert "kinds" in failed(Rendering("first", "app", "one", "vehicle-00", [odd]))


def test_a_second_pod_at_once_is_advice_only() -> None:
    checks = static_checks.object_checks([rendering(lambda d, *_: d["spec"].pop("strategy"))])
    advice = next(check for check in checks if check.name == "strategy")
    assert advice.passed
    assert "would double every message" in advice.found


def test_requests_of_all_containers_count() -> None:
    entry = {"spec": {"resources": {"cpu": "30m", "memory": "64Mi"}}}
    assert list(static_checks.resource_problems(rendering(), entry)) == []
    [cpu, memory] = static_checks.resource_problems(rendering(second_container()), entry)
    assert cpu == "the pod requests 60m of cpu, the entry has spec.resources.cpu 30m"
    assert memory.startswith("the pod requests 128Mi of memory")
    assert len(list(static_checks.resource_problems(rendering(of_container(resources={})), entry))) == 2


def test_containers_whose_probes_measure_an_update_are_asked() -> None:
    def problems(*names: str, change: Change = lambda *_: None) -> list[str]:
        entry = {"spec": {"success": {"probesOf": list(names), "seconds": 60}}}
        return list(static_checks.unanswered_probes([rendering(change)], entry))

    assert problems("app") == []
    assert problems() == list(static_checks.unanswered_probes([rendering()], {"spec": {}})) == []
    here = "spec.success.probesOf: no container second with a readiness probe (those with one: app)"
    assert problems("app", "second") == [here]
    assert problems("second", change=second_container(readinessProbe=None)) == [here]
    assert problems("second", change=second_container()) == []


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("30m", "0.03"),
        ("1", "1"),
        (2, "2"),
        (0.5, "0.5"),
        ("64Mi", "67108864"),
        ("1.5Gi", "1610612736"),
        ("2k", "2000"),
    ],
)
def test_quantities(text: Any, number: str) -> None:
    assert quantity(text) == Decimal(number)


@pytest.mark.parametrize("text", ["", "m", "-1", "1 Mi", "1Xi", None, True, [], "1e400M", "٣"])
def test_what_is_no_quantity(text: Any) -> None:
    assert quantity(text) is None


def test_quantities_are_written_as_charts_write_them() -> None:
    assert (written(Decimal("0.03"), "cpu"), written(Decimal(67108864), "memory")) == ("30m", "64Mi")
    assert (written(Decimal(2), "cpu"), written(Decimal(0), "memory")) == ("2000m", "0Mi")


STRICT = {
    "$schema": values_schemas.DIALECTS[0],
    "type": "object",
    "additionalProperties": False,
    "required": ["placement"],
    "properties": {
        "placement": {
            "type": "object",
            "description": "Where.",
            "additionalProperties": False,
            "required": ["agent"],
            "properties": {"agent": {"type": "string", "description": "Who.", "pattern": "^[a-z]+$"}},
        },
        "topics": {"type": "array", "description": "What.", "items": {"$ref": "#/$defs/topic"}},
        "free": {"type": "object", "description": "Any keys.", "additionalProperties": True},
    },
    "$defs": {
        "topic": {
            "type": "object",
            "additionalProperties": False,
            "properties": {"name": {"type": "string", "description": "Name."}},
        }
    },
}


def schema(change: Callable[[dict[str, Any]], Any] = lambda schema: None) -> dict[str, Any]:
    changed: dict[str, Any] = copy.deepcopy(STRICT)
    change(changed)
    return changed


def test_a_schema_names_its_values_also_by_reference() -> None:
    by_reference = schema(lambda one: one["properties"].update(one={"$ref": "#/$defs/topic"}))
    for names in (["placement"], ["placement", "agent"], ["one", "name"]):
        assert values_schemas.names_value(by_reference, *names)
    for names in (["guest"], ["placement", "guest"], ["one", "agent"], ["free", "guest"], ["one", "name", "x"]):
        assert not values_schemas.names_value(by_reference, *names)
    assert not values_schemas.names_value({"properties": []}, "placement")


def test_a_strict_schema_has_no_problem() -> None:
    assert values_schemas.strictness_problems(schema()) == []
    assert values_schemas.undescribed(schema()) == []


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda s: s.pop("additionalProperties"), "values: keys are described, but unknown ones pass"),
        (lambda s: s.pop("$schema"), "$schema: None is none of"),
        (lambda s: s.pop("type"), "values: the schema's top level must say type: object"),
        (lambda s: s["properties"]["placement"].update(additionalProperties=True), "values.placement: keys are"),
        (lambda s: s["$defs"]["topic"].pop("additionalProperties"), "values $defs/topic: keys are described"),
        (lambda s: s["properties"]["free"].pop("additionalProperties"), "values.free: an object with any keys, and"),
        (lambda s: s["properties"].update(x={"type": ["object", "null"]}), "values.x: an object with any keys"),
        (lambda s: s["properties"].update(x={"anyOf": [{"type": "object"}]}), "values.x: an object with any keys"),
        (lambda s: s["properties"].update(x={"items": {"type": "object"}}), "values.x[]: an object with any keys"),
        (lambda s: s["properties"].update(x={"allOf": [{"$ref": "file:///etc/x"}]}), "'file:///etc/x' is not"),
    ],
)  # fmt: skip
def test_a_schema_that_lets_pass_what_it_should_not(change: Callable[[Any], Any], problem: str) -> None:
    assert [one for one in values_schemas.strictness_problems(schema(change)) if problem in one] != []


def test_conditions_need_not_be_strict() -> None:
    condition = {"if": {"properties": {"kind": {"const": "a"}}}, "then": {"required": ["name"]}}
    assert values_schemas.strictness_problems(schema(lambda s: s["$defs"]["topic"].update(condition))) == []


def test_keys_without_a_description_are_named() -> None:
    changed = schema(lambda s: s["properties"]["placement"]["properties"]["agent"].update(description=" "))
    assert values_schemas.undescribed(changed) == ["values.placement.agent"]


def test_values_that_the_schema_does_not_name() -> None:
    values = {"placement": {"agent": "", "node": "x"}, "more": 1, "topics": [], "free": {"any": 1}}
    assert values_schemas.unknown_values(schema(), values) == ["values.placement.node", "values.more"]


def test_an_empty_default_may_stand_for_what_must_be_given() -> None:
    assert values_schemas.must_be_given(STRICT, ("placement", "agent"), "")
    assert not values_schemas.must_be_given(STRICT, ("placement", "agent"), "X")
    assert not values_schemas.must_be_given(STRICT, ("placement", "node"), "")
    assert not values_schemas.must_be_given(STRICT, ("nowhere", "at", "all"), "")
    assert not values_schemas.must_be_given(STRICT, (), "")


def test_values_are_joined_as_helm_joins_them() -> None:
    defaults = {"a": {"b": 1, "c": [1, 2]}, "d": 1, "e": {"f": 1}}
    given = {"a": {"c": [3]}, "d": None, "e": 2, "g": {"h": 1}}
    assert values_schemas.overlay(defaults, given) == {"a": {"b": 1, "c": [3]}, "e": 2, "g": {"h": 1}}


@pytest.mark.parametrize(
    "odd", [{}, {"properties": 1}, {"properties": {"x": True}}, {"anyOf": 3}, {"$ref": "#/$defs/x"}]
)
def test_schemas_of_the_wrong_form_are_no_crash(odd: dict[str, Any]) -> None:
    assert values_schemas.strictness_problems(odd) != []
    values_schemas.undescribed(odd)
    values_schemas.unknown_values(odd, {"x": {"y": 1}})


def test_a_schema_nested_without_end_is_no_crash() -> None:
    deep: dict[str, Any] = {}
    for _ in range(900):
        deep = {"properties": {"x": deep}}
    assert "$ref: '(nested too deeply)' is not in this file" in values_schemas.strictness_problems(deep)
    looped = {"$ref": "#/$defs/a", "$defs": {"a": {"$ref": "#/$defs/a"}}}
    assert values_schemas.unknown_values(looped, {"x": 1}) == ["values.x"]
