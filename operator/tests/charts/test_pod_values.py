"""What people set for the pods of a component reaches these pods, and those of no other component."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.stages.paths import CHARTS

Object = dict[str, Any]

pytestmark = pytest.mark.toolchain
PLATFORM = CHARTS / "robotkube"
PROFILE = Path(__file__).parent / "profiles" / "official.yaml"
WORKLOADS = {
    "managers": "Deployment/manager",
    "gate": "Deployment/gate",
    "suites": "Deployment/suite-runner",
    "inspection": "Deployment/inspector",
    "remover": "Deployment/remover",
    "rights": "Deployment/rights",
    "console": "Deployment/console",
    "certificates": "Deployment/certificates",
    "broker": "Deployment/broker",
    "database": "StatefulSet/database",
    "forge": "StatefulSet/forge",
    "bootstrap": "Job/bootstrap",
    "teardown": "Job/teardown",
    "installationTest": "Job/installation-test",
}
KEY_JOB = "Job/gate-key"  # its name goes on with a hash, its pod has the gate's values
EVERYBODY = {*WORKLOADS.values(), KEY_JOB}
TOLERATION = {"key": "dedicated", "operator": "Equal", "value": "platform", "effect": "NoSchedule"}
RULE = {"matchExpressions": [{"key": "disk", "operator": "In", "values": ["fast"]}]}
AFFINITY = {"nodeAffinity": {"requiredDuringSchedulingIgnoredDuringExecution": {"nodeSelectorTerms": [RULE]}}}
FIELD = {"name": "NODE", "valueFrom": {"fieldRef": {"fieldPath": "spec.nodeName"}}}
GIVEN: dict[str, Any] = {
    "nodeSelector": {"disk": "fast"},
    "tolerations": [TOLERATION],
    "affinity": AFFINITY,
    "podAnnotations": {"example.com/scrape": "true"},
    "podLabels": {"team": "fleet"},
    "extraEnv": [{"name": "HTTP_PROXY", "value": "http://exit.example:3128"}, FIELD],
    "priorityClassName": "platform-critical",
}
EVERYWHERE: dict[str, Any] = {"imagePullSecrets": [{"name": "registry"}], "commonLabels": {"cost-centre": "42"}}


def values_of(component: str, values: Object) -> Object:
    """The values file that sets these of a component."""
    return {"managers": [{"name": "manager", **values}]} if component == "managers" else {component: values}


def seen(rendered: Any, key: str) -> dict[str, Any]:
    """What every workload's pod has where a value leads to."""
    workloads = rendered.of_kind("Deployment", "StatefulSet", "Job")
    parts = {
        f"{workload['kind']}/{workload['metadata']['name']}": part(workload["spec"]["template"], key)
        for workload in workloads
    }
    return {KEY_JOB if name.startswith(f"{KEY_JOB}-") else name: value for name, value in parts.items()}


def part(template: Object, key: str) -> Any:
    """The part of a pod template where a value leads to."""
    metadata, pod = template["metadata"], template["spec"]
    places = {"podAnnotations": metadata.get("annotations", {}), "podLabels": metadata["labels"]}
    places |= {"commonLabels": metadata["labels"], "extraEnv": pod["containers"][0].get("env", [])}
    return places[key] if key in places else pod.get(key)


def holds(found: Any, given: Any) -> bool:
    """Return whether all that was given is in what was found, beside what the chart sets itself."""
    if isinstance(given, dict):
        return isinstance(found, dict) and all(found.get(key) == value for key, value in given.items())
    return all(item in (found or []) for item in given) if isinstance(given, list) else bool(found == given)


@pytest.fixture(scope="module")
def shaped(helm: Any) -> Callable[[str], Any]:
    """The chart with everything set for one component, rendered once."""
    return functools.cache(lambda component: helm.template(PLATFORM, PROFILE, **values_of(component, GIVEN)))


@pytest.mark.parametrize("key", GIVEN)
@pytest.mark.parametrize("component", WORKLOADS)
def test_what_is_set_for_a_component_reaches_its_pods_alone(
    shaped: Callable[[str], Any], component: str, key: str
) -> None:
    parts = seen(shaped(component), key)
    assert set(parts) == EVERYBODY
    own = {WORKLOADS[component], *([KEY_JOB] if component == "gate" else [])}
    assert {name for name, value in parts.items() if holds(value, GIVEN[key])} == own


@pytest.mark.parametrize("key", EVERYWHERE)
def test_what_is_set_for_the_chart_reaches_every_pod(helm: Any, key: str) -> None:
    parts = seen(helm.template(PLATFORM, PROFILE, **{key: EVERYWHERE[key]}), key)
    assert {name for name, value in parts.items() if holds(value, EVERYWHERE[key])} == EVERYBODY


def test_common_labels_are_on_every_object_and_in_no_selector(helm: Any) -> None:
    rendered = helm.template(PLATFORM, PROFILE, commonLabels={"team": "all"}, gate={"podLabels": {"team": "gate"}})
    assert {one["metadata"]["labels"]["team"] for one in rendered.objects} == {"all"}
    assert seen(rendered, "podLabels")["Deployment/gate"]["team"] == "gate", "the component's own go before"
    selectors = [one["spec"]["selector"] for one in rendered.of_kind("Deployment", "StatefulSet", "Service")]
    assert not [selector for selector in selectors if "team" in str(selector)]


@pytest.mark.parametrize("key", ["nodeSelector", "tolerations"])
def test_a_component_without_a_place_of_its_own_has_the_platforms(helm: Any, key: str) -> None:
    whole: Any = {"nodeSelector": {"role": "platform"}, "tolerations": [{"operator": "Exists"}]}
    parts = seen(helm.template(PLATFORM, PROFILE, platform=whole, gate={key: GIVEN[key]}), key)
    assert parts.pop("Deployment/gate") == parts.pop(KEY_JOB) == GIVEN[key]
    assert all(value == whole[key] for value in parts.values())


def test_what_is_set_to_nothing_changes_nothing(helm: Any) -> None:
    empty = {key: type(value)() for key, value in GIVEN.items()}
    values = {key: type(value)() for key, value in EVERYWHERE.items()}
    for component in WORKLOADS:
        values |= values_of(component, empty)
    assert helm.template(PLATFORM, PROFILE, **values).objects == helm.template(PLATFORM, PROFILE).objects


@pytest.mark.parametrize("component", WORKLOADS)
def test_unknown_keys_of_pods_are_refused(helm: Any, component: str) -> None:
    said = helm.refusal(PLATFORM, PROFILE, **values_of(component, {"podLabel": {"team": "fleet"}}))
    assert "additional properties 'podLabel' not allowed" in said


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"commonLabels": {"helm.sh/chart": "x"}}, "commonLabels: helm.sh/chart is set by the chart itself."),
        ({"gate": {"podLabels": {"app.kubernetes.io/name": "x"}}}, "gate.podLabels: app.kubernetes.io/name is set"),
        ({"forge": {"podAnnotations": {"robotkube.io/keys": "x"}}}, "forge.podAnnotations: robotkube.io/keys is set"),
        (values_of("managers", {"podLabels": {"robotkube.io/agent": "x"}}), "managers[0].podLabels: robotkube.io/"),
    ],
)
def test_labels_and_annotations_of_the_chart_are_its_own(helm: Any, values: Object, said: str) -> None:
    refusal = helm.refusal(PLATFORM, PROFILE, **values)
    assert said in refusal
    assert "Use a key of your own, such as example.com/team." in refusal


@pytest.mark.parametrize(
    ("values", "at"),
    [
        ({"commonLabels": {"team": "a b"}}, "at '/commonLabels/team': 'a b' does not match"),
        ({"imagePullSecrets": ["registry"]}, "at '/imagePullSecrets/0'"),
        ({"forge": {"extraEnv": {"A": "b"}}}, "at '/forge/extraEnv'"),
        ({"forge": {"extraEnv": [{"value": "b"}]}}, "at '/forge/extraEnv/0': missing property 'name'"),
        ({"broker": {"affinity": {"zone": {}}}}, "at '/broker/affinity': additional properties 'zone' not allowed"),
        ({"broker": {"priorityClassName": "High"}}, "at '/broker/priorityClassName': 'High' does not match"),
        ({"broker": {"tolerations": [{"key": "a", "effect": "Never"}]}}, "at '/broker/tolerations/0/effect'"),
    ],
)
def test_the_schema_refuses_what_is_no_such_value(helm: Any, values: Object, at: str) -> None:
    assert at in helm.refusal(PLATFORM, PROFILE, **values)


@pytest.mark.parametrize("chart", sorted(path.parent.name for path in CHARTS.glob("apps/*/values.schema.json")))
def test_the_chart_of_an_application_takes_none_of_them(helm: Any, chart: str) -> None:
    given = GIVEN | EVERYWHERE
    words = helm.refusal(CHARTS / "apps" / chart, PROFILE.parent / f"{chart}.yaml", **given)
    assert [key for key in given if f"'{key}'" not in words] == []
