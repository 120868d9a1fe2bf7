"""Several managers with disjoint scopes: what each gets, and what is refused with the way out."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.delivery.console import settings as console
from robotkube.delivery.deployment.core.policies.merge import AUTOMATIC, read_merge_policy
from robotkube.delivery.gate import __main__ as gate
from robotkube.delivery.manager import __main__ as manager
from robotkube.errors import DocumentError
from robotkube.foundation.runtime.settings_file import read_settings
from tests.stages.paths import CHARTS
from tests.stages.settings_mounted import GATE, mounted

pytestmark = pytest.mark.toolchain

PROFILES = Path(__file__).parent / "profiles"
PLATFORM = CHARTS / "robotkube"
KINDS = {"Deployment", "Service", "ServiceAccount", "ConfigMap", "ClusterRole", "ClusterRoleBinding", "Lease"}
VEHICLE, CLOUD = {"agents": ["vehicle-00"]}, {"agents": ["vehicle-01", "cloud-0"]}
NORTH, SOUTH = {"name": "north", "scope": VEHICLE}, {"name": "south", "scope": CLOUD}


@pytest.fixture(scope="module")
def two(helm: Any) -> Any:
    return helm.template(PLATFORM, PROFILES / "official.yaml", PROFILES / "managers.yaml")


def settings(rendered: Any, name: str) -> dict[str, Any]:
    namespace = GATE if name == "gate" else None
    return dict(yaml.safe_load(rendered.one("ConfigMap", name, namespace)["data"]["config.yaml"]))


def test_managers_render_as_committed(two: Any, golden: Callable[[str, str], None]) -> None:
    parts = [part for part in two.text.split("---\n") if "# Source: robotkube/templates/manager/" in part]
    golden("managers", "---\n".join(["", *parts]))


def test_each_manager_has_objects_of_its_own(two: Any) -> None:
    for name in ("manager", "manager-north"):
        known = {name, f"robotkube-{name}", f"robotkube-manager-{name}"}
        assert {o["kind"] for o in two.objects if o["metadata"]["name"] in known} >= KINDS
        [account] = two.one("ClusterRoleBinding", f"robotkube-{name}")["subjects"]
        assert account["name"] == name
        assert two.one("Secret", f"forge-account-{name}")["stringData"]["username"] == name
    assert two.one("Deployment", "manager-north")["spec"]["replicas"] == 2


def test_a_manager_with_namespaces_has_no_right_on_tasks_elsewhere(two: Any) -> None:
    assert two.one("ClusterRole", "robotkube-manager-north")["rules"] == [
        {"apiGroups": [""], "resources": ["nodes"], "verbs": ["get", "list", "watch"]}
    ]
    roles = {
        r["metadata"].get("namespace")
        for r in two.of_kind("Role")
        if r["metadata"]["name"] == "robotkube-manager-north"
    }
    assert roles == {None, "argocd", "vehicle-01", "default"}


def test_the_gate_takes_from_each_what_is_in_its_scope(two: Any) -> None:
    scopes = {"manager": ["vehicle-00", "cloud-0"], "manager-north": ["vehicle-01"]}
    assert settings(two, "gate")["forge"]["proposers"] == [
        {
            "account": name,
            "namespaces": namespaces,
            "webhook": f"https://{name}.robotkube.svc.cluster.local:8080/webhook",
            "secret": f"/var/run/secrets/robotkube/proposers/{name}/secret",
        }
        for name, namespaces in scopes.items()
    ]


def test_no_manager_has_what_the_forge_signs_for_others_with(two: Any) -> None:
    everybody = {"Deployment/gate", "Job/bootstrap"}
    assert holders(two) == {
        "forge-webhook-gate": everybody,
        "forge-webhook-manager": {*everybody, "Deployment/manager"},
        "forge-webhook-manager-north": {*everybody, "Deployment/manager-north"},
        "forge-webhook-rights": {"Deployment/rights", "Job/bootstrap"},
    }


def test_on_an_external_forge_only_who_hears_has_a_secret(helm: Any) -> None:
    external = {"kind": "external", "external": {"url": "https://git.example"}}
    rendering = helm.template(PLATFORM, PROFILES / "official.yaml", forge=external)
    assert holders(rendering) == {
        "forge-webhook-gate": {"Deployment/gate"},
        "forge-webhook-manager": {"Deployment/gate", "Deployment/manager"},
        "forge-webhook-rights": {"Deployment/rights"},
    }


def holders(rendered: Any) -> dict[str, set[str]]:
    """The secrets of webhooks, with the pods that mount them."""
    names = [o["metadata"]["name"] for o in rendered.of_kind("Secret")]
    mounting: dict[str, set[str]] = {name: set() for name in names if name.startswith("forge-webhook")}
    for pod, specification in rendered.pods:
        for volume in specification.get("volumes", []):
            sources = [*volume.get("projected", {}).get("sources", []), volume]
            mounted = {s["secret"].get("name") or s["secret"]["secretName"] for s in sources if "secret" in s}
            for name in mounted & set(mounting):
                mounting[name].add(pod)
    return mounting


def test_the_console_knows_whose_namespaces_are_whose(two: Any, official: Any, tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "all").mkdir()
    several = read_settings(mounted(two, "console", tmp_path / "one"), console.read_configuration).managers
    assert {one.name: one.namespaces for one in several} == {
        "manager": {"vehicle-00", "cloud-0"},
        "manager-north": {"vehicle-01", "default"},
    }
    [alone] = read_settings(mounted(official, "console", tmp_path / "all"), console.read_configuration).managers
    assert alone.answers("vehicle-77")


def test_the_policy_merges_by_itself_what_is_in_the_authors_scope(two: Any, official: Any) -> None:
    policy = read_merge_policy(two.one("ConfigMap", "bootstrap-seed")["data"]["deployment--policies--merge.yaml"])
    assert policy.way_of_plan("manager-north", ["releases/vehicle-01/a.yaml", "sources/vehicle-01/b.yaml"]) == AUTOMATIC
    assert policy.way_of_plan("manager-north", ["releases/vehicle-00/a.yaml"]) != AUTOMATIC
    assert policy.way_of_plan("manager", ["releases/vehicle-00/a.yaml"]) == AUTOMATIC
    alone = official.one("ConfigMap", "bootstrap-seed")["data"]["deployment--policies--merge.yaml"]
    assert alone == (PLATFORM / "files/deployment/policies/merge.yaml").read_text()


def test_the_forge_knows_every_manager_and_tells_it(two: Any) -> None:
    forge = settings(two, "bootstrap")["forge"]
    assert {"manager", "manager-north"} <= {account["name"] for account in forge["accounts"]}
    for repository in forge["repositories"]:
        assert {name: repository["access"][name] for name in ("manager", "manager-north")} == {
            "manager": "read",
            "manager-north": "read",
        }
        assert repository["main"] == ["gate"]
    called = {hook["url"].partition("//")[2].partition(".")[0] for hook in forge["webhooks"]}
    assert called == {"gate", "manager", "manager-north", "rights"}


def test_namespaces_are_those_of_the_agents_when_left_out(helm: Any) -> None:
    rendering = helm.template(PLATFORM, PROFILES / "official.yaml", managers=[NORTH, SOUTH])
    assert settings(rendering, "north")["scope"] == {
        "agents": ["vehicle-00"],
        "namespaces": ["vehicle-00"],
        "applications": ["*"],
    }
    assert settings(rendering, "south")["node_lost_seconds"] == 40


REFUSALS: dict[str, tuple[list[dict[str, Any]], str]] = {
    "nobody": ([], "managers is empty: nobody would answer tasks. Leave the key out for one manager of everything"),
    "an agent that is not declared": (
        [{"name": "a", "scope": {"agents": ["vehicle-00", "vehicle-01", "cloud-0", "vehicle-77"]}}],
        'scope.agents names "vehicle-77", which is none of agents. Declare it there',
    ),
    "a namespace of the platform": (
        [NORTH, {**SOUTH, "scope": {**CLOUD, "namespaces": ["vehicle-01", "cloud-0", "robotkube"]}}],
        'scope.namespaces names "robotkube", which belongs to the platform: no task can stand there. Take it out.',
    ),
    "all and others": ([{"name": "a", "scope": {"agents": ["*", "cloud-0"]}}], "scope.agents names * and others."),
    "the name of a part": ([{"name": "gate"}], 'managers[0] "gate": this name belongs to a part of the platform.'),
    "the name of an organisation": (
        [{"name": "staging-publisher"}],
        'managers[0] "staging-publisher": this name belongs to a part of the platform.',
    ),
    "the name of an agent": ([{"name": "cloud-0"}], 'managers[0] "cloud-0": an agent has this name'),
    "a name that is no label": ([{"name": "North"}], "Use at most 30 lower case letters, digits and hyphens"),
    "one name twice": ([NORTH, {**SOUTH, "name": "north"}], 'managers[1] "north": declared twice.'),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_the_chart_refuses_managers_with_the_way_out(helm: Any, case: str) -> None:
    managers, message = REFUSALS[case]
    said = helm.refusal(PLATFORM, PROFILES / "official.yaml", managers=managers)
    assert "in the values, nothing was changed:" in said
    assert message in said


APART: dict[str, tuple[list[dict[str, Any]], str]] = {
    "scopes that overlap": (
        [NORTH, {"name": "south", "scope": {"agents": ["vehicle-00", "vehicle-01", "cloud-0"]}}],
        "managers 'north' and 'south' both have vehicle-00 in scope.agents: a release would have two authors",
    ),
    "everything twice": ([{"name": "a"}, {"name": "b"}], "managers 'a' and 'b' both have * in scope.namespaces"),
    "everything, and a part of it": (
        [{"name": "a"}, {"name": "b", "scope": VEHICLE}],
        "managers 'a' and 'b' both have vehicle-00 in scope.agents",
    ),
    "namespaces that overlap": (
        [
            {**NORTH, "scope": {**VEHICLE, "namespaces": ["vehicle-00", "people"]}},
            {**SOUTH, "scope": {**CLOUD, "namespaces": ["vehicle-01", "cloud-0", "people"]}},
        ],
        "managers 'north' and 'south' both have people in scope.namespaces",
    ),
    "an agent that nobody has": (
        [NORTH, {"name": "south", "scope": {"agents": ["cloud-0"]}}],
        "agent 'vehicle-01' is in no manager's scope, so nothing would ever run on it; add it to scope.agents",
    ),
    "an agent without its namespace": (
        [{"name": "north", "scope": {"agents": ["*"], "namespaces": ["cloud-0", "vehicle-00"]}}],
        "'vehicle-01' is in scope.agents, but not in scope.namespaces: operators launched there",
    ),
    "a namespace without its agent": (
        [{**NORTH, "scope": {**VEHICLE, "namespaces": ["*"]}}],
        "'cloud-0' is in scope.namespaces, but not in scope.agents: operators launched there",
    ),
    "an operator of somebody else": (
        [{**NORTH, "operators": [{"namespace": "vehicle-01"}]}, SOUTH],
        "operator 'vehicle-01' is not in scope.namespaces: declare it at the manager that answers it",
    ),
    "an operator with more than its manager": (
        [{**NORTH, "operators": [{"namespace": "vehicle-00", "agents": ["cloud-0"]}]}, SOUTH],
        "operator 'vehicle-00' has cloud-0 in agents, more than its manager's scope.agents",
    ),
    "an operator with everything": (
        [{**NORTH, "operators": [{"namespace": "vehicle-00", "agents": ["*"]}]}, SOUTH],
        "operator 'vehicle-00' has * in agents, more than its manager's scope.agents",
    ),
    "an operator twice": (
        [{**NORTH, "operators": [{"namespace": "vehicle-00"}, {"namespace": "vehicle-00"}]}, SOUTH],
        "operators[1]: operator 'vehicle-00' is declared twice; remove one",
    ),
}


@pytest.mark.parametrize("case", APART)
def test_what_the_chart_lets_through_the_first_manager_refuses(helm: Any, case: str, tmp_path: Path) -> None:
    managers, message = APART[case]
    rendered = helm.template(PLATFORM, PROFILES / "official.yaml", managers=managers)
    with pytest.raises(DocumentError) as refused:
        read_settings(mounted(rendered, managers[0]["name"], tmp_path), manager.read_configuration)
    assert message in str(refused.value)


@pytest.mark.parametrize("name", ["north", "south"])
def test_managers_that_overlap_all_refuse_to_start(helm: Any, name: str, tmp_path: Path) -> None:
    managers, message = APART["scopes that overlap"]
    rendered = helm.template(PLATFORM, PROFILES / "official.yaml", managers=managers)
    with pytest.raises(DocumentError, match=message):
        read_settings(mounted(rendered, name, tmp_path), manager.read_configuration)


@pytest.mark.parametrize("case", ["scopes that overlap", "everything twice", "everything, and a part of it"])
def test_the_gate_refuses_two_authors_for_an_agent(helm: Any, case: str, tmp_path: Path) -> None:
    rendered = helm.template(PLATFORM, PROFILES / "official.yaml", managers=APART[case][0])
    with pytest.raises(DocumentError) as refused:
        read_settings(mounted(rendered, "gate", tmp_path), gate.read_configuration)
    one, other = (manager_values["name"] for manager_values in APART[case][0])
    assert f"forge.proposers: managers {one!r} and {other!r} both have " in str(refused.value)
    assert "name each in one manager only (charts/robotkube, values managers)" in str(refused.value)


def test_managers_apart_start_and_so_does_the_gate(two: Any, tmp_path: Path) -> None:
    for name in ("manager", "manager-north"):
        configuration = read_settings(mounted(two, name, tmp_path / name), manager.read_configuration)
        assert configuration.manager.operators.manager.is_narrow
    assert len(read_settings(mounted(two, "gate", tmp_path / "gate"), gate.read_configuration).gate.proposers) == 2


def test_the_earlier_value_is_refused_with_the_way_over(helm: Any) -> None:
    resources = {"requests": {"cpu": "50m"}}
    said = helm.refusal(PLATFORM, PROFILES / "official.yaml", manager={"resources": resources})
    assert "manager: this value was replaced by the list managers. Move its resources to managers[0].resources" in said
    assert "upgrade with --reset-then-reuse-values instead of --reuse-values" in said


@pytest.mark.parametrize(
    ("manager", "at"),
    [
        ({"scope": {}}, "at '/managers/0': missing property 'name'"),
        ({"name": "a", "agents": []}, "at '/managers/0': additional properties 'agents' not allowed"),
        ({"name": "a", "scope": {"agents": []}}, "at '/managers/0/scope/agents': minItems"),
        ({"name": "a", "scope": {"agents": ["vehicle-*"]}}, "at '/managers/0/scope/agents/0'"),
        ({"name": "a", "replicas": 0}, "at '/managers/0/replicas': minimum"),
        ({"name": "a", "operators": [{}]}, "at '/managers/0/operators/0': missing property 'namespace'"),
    ],
)
def test_the_schema_refuses_what_it_does_not_know(helm: Any, manager: dict[str, Any], at: str) -> None:
    assert at in helm.refusal(PLATFORM, PROFILES / "official.yaml", managers=[manager])


def test_every_key_of_a_manager_is_explained() -> None:
    schema = json.loads((PLATFORM / "values.schema.json").read_text())
    manager = schema["properties"]["managers"]["items"]["properties"]
    assert all("description" in rule or "$ref" in rule for rule in manager.values())
