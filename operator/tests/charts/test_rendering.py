"""What the charts render: committed examples, Pod Security, rights, and where nothing may stand."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.foundation.documents.core.quantities import quantity
from tests.stages.paths import CHARTS
from tests.stages.settings_mounted import CERTIFICATE, GATE, KEY_SECRETS, pod_of

pytestmark = pytest.mark.toolchain

Object = dict[str, Any]

APP_CHARTS = ("mqtt-bridge", "event-detector", "bag-player", "object-detection", "object-tracking")
PROFILES = ("official", "embedded")
FOLDER = Path(__file__).parent / "profiles"
# Cores requested by everything that runs all the time, Argo CD included: two cores carry the fleet, too.
PLATFORM_CPU_MAX = 1.2
PLATFORM = CHARTS / "robotkube"
PROFILE = Path(__file__).parent / "profiles" / "official.yaml"
OPTIONAL = {"Deployment/remover", "Deployment/console"}
AGENTS = ("vehicle-00", "vehicle-01", "cloud-0")
WRITE_VERBS = {"create", "update", "patch", "delete", "deletecollection", "*", "bind", "escalate", "impersonate"}


@pytest.fixture(params=PROFILES)
def platform(request: pytest.FixtureRequest) -> Any:
    return request.getfixturevalue(request.param)


@pytest.mark.parametrize("profile", PROFILES)
def test_platform_renders_as_committed(
    request: pytest.FixtureRequest, profile: str, golden: Callable[[str, str], None]
) -> None:
    golden(profile, request.getfixturevalue(profile).text)


def test_signing_in_by_the_forge_renders_as_committed(
    helm: Any, official: Any, golden: Callable[[str, str], None]
) -> None:
    """What differs from the platform where people sign in elsewhere."""
    known = set(official.text.split("---\n"))
    shown = helm.template(PLATFORM, PROFILE, FOLDER / "forge-sign-in.yaml").text.split("---\n")
    golden("forge-sign-in", "---\n".join(["", *(part for part in shown if part not in known)]))


@pytest.mark.parametrize("chart", APP_CHARTS)
def test_application_charts_render_as_committed(
    apps: Mapping[str, Any], chart: str, golden: Callable[[str, str], None]
) -> None:
    golden(chart, apps[chart].text)


def restricted_problems(pod: Object) -> list[str]:
    """The places at which a pod breaks Pod Security `restricted`, or our own rules: read-only root, resources, images
    by name."""
    problems = [f"{key} is set" for key in ("hostNetwork", "hostPID", "hostIPC") if pod.get(key)]
    security = pod.get("securityContext", {})
    if security.get("seccompProfile") != {"type": "RuntimeDefault"} or security.get("runAsNonRoot") is not True:
        problems.append("securityContext must set seccompProfile RuntimeDefault and runAsNonRoot")
    if not isinstance(security.get("runAsUser"), int) or security["runAsUser"] == 0:
        problems.append("runAsUser must be a number that is not root")
    kinds = {"configMap", "emptyDir", "projected", "secret", "downwardAPI", "persistentVolumeClaim", "ephemeral", "csi"}
    for volume in pod.get("volumes", []):
        problems += [f"volume {volume['name']}: {key}" for key in volume if key != "name" and key not in kinds]
        if "emptyDir" in volume and "sizeLimit" not in volume["emptyDir"]:
            problems.append(f"volume {volume['name']}: no sizeLimit")
    for container in [*pod.get("initContainers", []), *pod["containers"]]:
        problems += [f"{container['name']}: {problem}" for problem in container_problems(container)]
    return problems


def container_problems(container: Object) -> list[str]:
    expected = {"allowPrivilegeEscalation": False, "readOnlyRootFilesystem": True, "capabilities": {"drop": ["ALL"]}}
    problems = [] if container["securityContext"] == expected else [f"securityContext is not {expected}"]
    resources = container["resources"]
    if set(resources["requests"]) != {"cpu", "memory"} or "memory" not in resources["limits"]:
        problems.append("requests of CPU and memory and a limit of memory are needed")
    if not container["image"]:
        problems.append("no image")
    if "/tmp" not in {mount["mountPath"] for mount in container["volumeMounts"]}:  # noqa: S108
        problems.append("no folder for temporary files")
    return problems


def made_keys(platform: Any) -> int:
    """Return whether the chart has the key made: 1 or 0 Jobs."""
    return len([name for name, _ in platform.pods if name.startswith("Job/gate-key-")])


def test_every_pod_of_the_platform_runs_restricted(platform: Any) -> None:
    assert len(platform.pods) == 12 + len(OPTIONAL & set(dict(platform.pods))) + made_keys(platform)
    assert {name: problems for name, pod in platform.pods if (problems := restricted_problems(pod))} == {}


@pytest.mark.parametrize("chart", APP_CHARTS)
def test_every_pod_of_an_application_runs_restricted(apps: Mapping[str, Any], chart: str) -> None:
    [(_, pod)] = apps[chart].pods
    assert restricted_problems(pod) == []


NUMBER = "07"  # a name that YAML takes for something else: so do 1e3, on and 123


@pytest.mark.parametrize("chart", ["mqtt-bridge", "event-detector"])
def test_names_that_look_like_numbers_stay_names(helm: Any, chart: str) -> None:
    secret, claim = {"existingSecret": NUMBER}, {"claim": NUMBER}
    values = {"broker": secret}
    if chart == "event-detector":
        values |= {"database": secret, "webhooks": secret, "recordings": claim, "bags": claim}
    values |= {"placement": {"agent": NUMBER}}
    shown = helm.template(CHARTS / "apps" / chart, PROFILE.with_name(f"{chart}.yaml"), release="123", **values)
    config = yaml.safe_load(shown.one("ConfigMap", "123")["data"]["config.yaml"])
    deployment = shown.one("Deployment", "123")
    pod = deployment["spec"]["template"]["spec"]
    assert config.get("agent", NUMBER) == NUMBER
    assert deployment["metadata"]["labels"]["robotkube.io/agent"] == pod["nodeSelector"]["robotkube.io/agent"] == NUMBER
    assert deployment["spec"]["selector"]["matchLabels"]["app.kubernetes.io/instance"] == "123"
    named = [volume["secret"]["secretName"] for volume in pod["volumes"] if "secret" in volume]
    sources = [source for v in pod["volumes"] for source in v.get("projected", {}).get("sources", [])]
    named += [source["secret"]["name"] for source in sources if "secret" in source]
    named += [v["persistentVolumeClaim"]["claimName"] for v in pod["volumes"] if "persistentVolumeClaim" in v]
    assert set(named) == {NUMBER}


@pytest.mark.parametrize(
    ("chart", "empty", "expected"),
    [
        ("event-detector", ["detector"], {"topics": [], "rules": [], "reactions": [], "task": "", "state": "active"}),
        ("mqtt-bridge", ["bridge"], {"out": [], "in": [], "trace": "", "publish_types": False, "publish_gaps": True}),
    ],
)
def test_an_emptied_section_is_its_defaults(helm: Any, chart: str, empty: list[str], expected: Object) -> None:
    """As when everything below a key is commented out: YAML's null, which helm takes for `remove the default`."""
    values = dict.fromkeys([*empty, "terminationGracePeriodSeconds", "resources"])
    shown = helm.template(CHARTS / "apps" / chart, PROFILE.with_name(f"{chart}.yaml"), release="a", **values)
    config = yaml.safe_load(shown.one("ConfigMap", "a")["data"]["config.yaml"])
    assert {key: config[key] for key in expected} == expected
    assert "terminationGracePeriodSeconds" not in shown.one("Deployment", "a")["spec"]["template"]["spec"]


def test_the_checker_sees_what_it_looks_for(official: Any) -> None:
    _, pod = official.pods[0]
    pod["containers"][0]["securityContext"]["readOnlyRootFilesystem"] = False
    pod["volumes"].append({"name": "host", "hostPath": {"path": "/"}})
    pod["securityContext"]["runAsUser"] = 0
    assert len(restricted_problems(pod)) == 3


def test_every_process_has_probes(platform: Any) -> None:
    for name, pod in platform.pods:
        if not name.startswith("Job/"):
            for container in pod["containers"]:
                assert {"startupProbe", "readinessProbe", "livenessProbe"} <= set(container), name


def cores(container: Mapping[str, Any]) -> float:
    return float(quantity(container["resources"]["requests"]["cpu"]) or "nan")  # which is within no bound


def test_the_platform_fits_on_two_cores(embedded: Any, argocd: list[Object]) -> None:
    pods = [pod for name, pod in embedded.pods if not name.startswith("Job/")]
    pods += [o["spec"]["template"]["spec"] for o in argocd if o["kind"] in {"Deployment", "StatefulSet"}]
    requested = sum(cores(container) for pod in pods for container in pod["containers"])
    assert requested < PLATFORM_CPU_MAX


def test_embedded_pods_run_on_the_platform_nodes(embedded: Any) -> None:
    for name, pod in embedded.pods:
        assert pod["nodeSelector"] == {"robotkube.io/role": "platform"}, name
        assert pod["tolerations"][0]["value"] == "platform", name


def test_the_manager_may_write_nothing_but_tasks_events_and_its_lease(platform: Any) -> None:
    written = [
        rule["resources"]
        for kind, namespace in (("ClusterRole", None), ("Role", "argocd"), ("Role", None))
        for rule in platform.one(kind, "robotkube-manager", namespace)["rules"]
        if WRITE_VERBS & set(rule["verbs"])
    ]
    assert written == [["taskdescriptions"], ["taskdescriptions/status"], ["events"], ["leases"], ["events"]]


def test_only_these_have_a_right_beyond_a_namespace(platform: Any) -> None:
    names = {role["metadata"]["name"] for role in platform.of_kind("ClusterRole")}
    consoles = {"robotkube-console"} if "Deployment/console" in dict(platform.pods) else set()
    assert names == {"robotkube-inspector", "robotkube-manager", "robotkube-suite-runner"} | consoles


def test_the_console_writes_nothing_and_reads_no_secret(official: Any) -> None:
    roles = [
        role for role in official.of_kind("Role", "ClusterRole") if role["metadata"]["name"] == "robotkube-console"
    ]
    rules = [rule for role in roles for rule in role["rules"]]
    assert len(roles) == 3 + len(AGENTS)
    assert {verb for rule in rules for verb in rule["verbs"]} == {"get", "list", "watch"}
    assert "secrets" not in {resource for rule in rules for resource in rule["resources"]}


def test_people_at_the_console_write_tasks_in_the_listed_namespaces_alone(helm: Any) -> None:
    twice = {"group": "robotkube:operators", "namespaces": ["cloud-0"]}
    sign_in = {"groups": ["robotkube", "robotkube:operators"], "writers": [twice, twice]}
    rendered = helm.template(PLATFORM, FOLDER / "official.yaml", console={"signIn": sign_in})
    rules = rendered.one("ClusterRole", "robotkube-console", None)["rules"]
    whom = {tuple(rule["resources"]): rule.get("resourceNames") for rule in rules if rule["verbs"] == ["impersonate"]}
    assert whom == {
        ("users",): ["robotkube:console"],
        ("groups",): ["robotkube:console:robotkube:operators"],
        ("userextras/robotkube.io/person",): None,  # gives no right
    }
    roles = [role for role in rendered.of_kind("Role") if role["metadata"]["name"] == "robotkube-console-writer"]
    assert [role["metadata"]["namespace"] for role in roles] == ["cloud-0"]
    assert roles[0]["rules"] == [
        {"apiGroups": ["robotkube.io"], "resources": ["taskdescriptions"], "verbs": ["create", "delete"]}
    ]
    bindings = [one for one in rendered.of_kind("RoleBinding") if one["roleRef"]["name"] == "robotkube-console-writer"]
    assert [(binding["metadata"]["namespace"], binding["subjects"][0]["name"]) for binding in bindings] == [
        ("cloud-0", "robotkube:console:robotkube:operators")
    ]


def test_the_suite_runner_reads_numbers_of_nodes_and_nothing_else_of_them(platform: Any) -> None:
    rules = platform.one("ClusterRole", "robotkube-suite-runner", None)["rules"]
    assert rules == [{"apiGroups": [""], "resources": ["nodes/stats"], "verbs": ["get"]}]


def test_the_inspector_may_not_reach_into_containers(platform: Any) -> None:
    """`nodes/proxy` runs commands in every container of a node."""
    rules = platform.one("ClusterRole", "robotkube-inspector")["rules"]
    assert [(rule["resources"], rule["verbs"]) for rule in rules] == [(["nodes"], ["list"]), (["nodes/pods"], ["get"])]


def test_the_gate_has_no_right_and_no_token(platform: Any) -> None:
    subjects = [
        (subject["name"], binding["metadata"]["name"])
        for binding in platform.of_kind("RoleBinding", "ClusterRoleBinding")
        for subject in binding["subjects"]
        if subject.get("namespace") in ("robotkube", "robotkube-gate")
    ]
    optional = {name.partition("/")[2] for name in OPTIONAL & set(dict(platform.pods))}
    job = {"gate-key"} if made_keys(platform) else set()
    own = {"manager", "bootstrap", "teardown", "installation-test", "suite-runner", "inspector", "certificates"}
    assert {name for name, _ in subjects} == own | optional | job
    pod = dict(platform.pods)["Deployment/gate"]
    assert pod["automountServiceAccountToken"] is False
    assert "serviceAccountToken" not in json.dumps(pod["volumes"])


def test_the_bootstrap_may_only_get_and_patch_named_objects(platform: Any) -> None:
    for rule in platform.one("Role", "robotkube-bootstrap", "argocd")["rules"]:
        assert rule["verbs"] == ["get", "patch"]
        assert rule["resourceNames"]


def namespace_of(document: Mapping[str, Any]) -> str:
    return str(document["metadata"].get("namespace", "robotkube"))


def test_no_right_reaches_pods_for_writing_or_secrets_for_listing(platform: Any) -> None:
    for role in platform.of_kind("Role", "ClusterRole"):
        in_test_namespace = role["metadata"].get("namespace", "").startswith("robotkube-suite-")
        for rule in role["rules"]:
            assert "*" not in [*rule["verbs"], *rule["resources"], *rule["apiGroups"]]
            if "pods" in rule["resources"] and role["metadata"]["name"] == "remover":
                assert rule["verbs"] == ["get", "delete"]
                assert role["metadata"]["namespace"] in AGENTS
            elif "pods" in rule["resources"] and not in_test_namespace:
                assert not WRITE_VERBS & set(rule["verbs"])
            if "secrets" in rule["resources"] and in_test_namespace:
                assert rule["verbs"] == ["create", "delete"]
            elif "secrets" in rule["resources"] and role["metadata"]["name"] == "certificates":
                there = [
                    one["metadata"] for one in platform.of_kind("Secret") if namespace_of(one) == namespace_of(role)
                ]
                named = {one["name"] for one in there if "tls" in one["name"] or is_account(one["name"])}
                assert set(rule["resourceNames"]) == named
                assert rule["verbs"] == ["get", "patch"]
            elif "secrets" in rule["resources"] and role["metadata"].get("namespace") == "robotkube-gate":
                assert rule["verbs"] == ["create"]
            elif "secrets" in rule["resources"]:
                assert rule["resourceNames"] == ["argocd-secret"]


@pytest.mark.parametrize("chart", APP_CHARTS)
def test_application_charts_make_one_deployment_and_one_configmap(apps: Mapping[str, Any], chart: str) -> None:
    assert sorted((o["apiVersion"], o["kind"], o["metadata"]["name"]) for o in apps[chart].objects) == [
        ("apps/v1", "Deployment", chart),
        ("v1", "ConfigMap", chart),
    ]


@pytest.mark.parametrize("chart", APP_CHARTS)
def test_the_plan_stands_on_the_configmap_alone(apps: Mapping[str, Any], chart: str) -> None:
    [configmap], [deployment] = apps[chart].of_kind("ConfigMap"), apps[chart].of_kind("Deployment")
    assert configmap["metadata"]["annotations"] == {"robotkube.io/plan": "20261121-100000-1a2b3c"}
    assert "annotations" not in deployment["metadata"]
    pod = deployment["spec"]["template"]["metadata"].get("annotations", {})
    assert list(pod) == (["robotkube.io/settings"] if chart == "bag-player" else []), "who reads its settings once"


@pytest.mark.parametrize("chart", APP_CHARTS)
def test_application_pods_wait_for_nothing(apps: Mapping[str, Any], chart: str) -> None:
    [(_, pod)] = apps[chart].pods
    assert "initContainers" not in pod
    assert pod["enableServiceLinks"] is False
    assert pod["dnsConfig"] == {"options": [{"name": "ndots", "value": "1"}]}
    assert pod["automountServiceAccountToken"] is False
    assert pod["serviceAccountName"] == ("application" if chart.startswith("object-") else chart)
    assert pod["terminationGracePeriodSeconds"] == {"event-detector": 10}.get(chart, 3)
    assert cores(pod["containers"][0]) <= 0.05
    assert all("initialDelaySeconds" not in probe for key, probe in pod["containers"][0].items() if "Probe" in key)


@pytest.mark.parametrize("chart", ["mqtt-bridge", "event-detector", "bag-player", "application"])
def test_the_service_accounts_that_application_charts_name_are_made_for_every_agent(official: Any, chart: str) -> None:
    for agent in ("vehicle-00", "vehicle-01", "cloud-0"):
        assert official.one("ServiceAccount", chart, agent)["automountServiceAccountToken"] is False


def test_the_app_project_allows_what_the_application_charts_use_and_nothing_else(
    official: Any, apps: Mapping[str, Any]
) -> None:
    spec = official.one("AppProject", "robotkube-apps", "argocd")["spec"]
    used = {(o["apiVersion"].rpartition("/")[0], o["kind"]) for rendered in apps.values() for o in rendered.objects}
    assert {(kind["group"], kind["kind"]) for kind in spec["namespaceResourceWhitelist"]} == used
    assert spec["clusterResourceWhitelist"] == []
    assert spec["sourceRepos"] == ["oci://forge.robotkube.svc.cluster.local:3000/verified/*"]
    assert official.one("Secret", "robotkube-charts", "argocd")["stringData"]["url"] + "/*" == spec["sourceRepos"][0]
    assert [place["namespace"] for place in spec["destinations"]] == ["vehicle-00", "vehicle-01", "cloud-0"]


def test_the_seed_commit_holds_the_wiring_as_installed(official: Any) -> None:
    data = official.one("ConfigMap", "bootstrap-seed")["data"]
    for kind, name in (("AppProject", "robotkube-apps"), ("ApplicationSet", "releases")):
        copied = yaml.safe_load(data[f"deployment--bootstrap--{kind.lower()}.yaml"])
        assert copied == official.one(kind, name, "argocd")
    assert yaml.safe_load(data["deployment--policies--initial.yaml"]) == {"add": [], "remove": []}
    for source in sorted((CHARTS.parent / "registry" / "policies").glob("*.yaml")):
        assert data[f"catalogue--policies--{source.name}"] == source.read_text()


def test_the_seed_is_mounted_as_the_folders_that_the_settings_name(official: Any) -> None:
    data = official.one("ConfigMap", "bootstrap-seed")["data"]
    pod = dict(official.pods)["Job/bootstrap"]
    [volume] = [volume for volume in pod["volumes"] if volume["name"] == "seed"]
    items = {item["key"]: item["path"] for item in volume["configMap"]["items"]}
    assert set(items) == set(data)
    assert all(path == key.replace("--", "/") for key, path in items.items())
    settings = yaml.safe_load(official.one("ConfigMap", "bootstrap")["data"]["config.yaml"])
    for repository in settings["forge"]["repositories"]:
        folder = repository["seed"].removeprefix("/etc/robotkube/seed/")
        assert any(path.startswith(f"{folder}/") for path in items.values())


@pytest.mark.parametrize("process", ["manager", "gate", "suite-runner", "bootstrap", "teardown"])
def test_every_secret_that_settings_name_is_mounted(platform: Any, process: str) -> None:
    mounted = set()
    namespace = GATE if process == "gate" else None
    projected = [volume["projected"] for volume in pod_of(platform, process)["volumes"] if "projected" in volume]
    for source in (
        projection["secret"] for one in projected for projection in one["sources"] if "secret" in projection
    ):
        if source["name"] not in KEY_SECRETS and {item["key"] for item in source["items"]} != set(CERTIFICATE):
            secret = platform.one("Secret", source["name"], namespace)
            made = set(CERTIFICATE) if is_account(source["name"]) else set()
            assert {item["key"] for item in source["items"]} <= set(secret["stringData"]) | made
        mounted |= {f"/var/run/secrets/robotkube/{item['path']}" for item in source["items"]}
    settings = yaml.safe_load(platform.one("ConfigMap", process, namespace)["data"]["config.yaml"])
    for path in named_paths(settings):
        folders = ({f"{path}/{key}" for key in keys} for keys in (("username", "password"), CERTIFICATE))
        assert path in mounted or any(folder <= mounted for folder in folders), path


def test_secrets_are_files_but_where_a_program_takes_none(platform: Any) -> None:
    """A variable stands in what the process says of itself, and goes to the programs that it starts."""
    variables = {
        (workload, variable["name"])
        for workload, pod in platform.pods
        for container in (*pod.get("initContainers", ()), *pod["containers"])
        for variable in container.get("env", ())
        if "secretKeyRef" in variable.get("valueFrom", {})
    }
    assert variables <= {("StatefulSet/database", f"FERRETDB_SETUP_{what}") for what in ("USERNAME", "PASSWORD")}
    containers = (one for _, pod in platform.pods for one in (*pod.get("initContainers", ()), *pod["containers"]))
    assert [one["name"] for one in containers if one.get("envFrom")] == []


def is_account(secret: str) -> bool:
    """Return whether a Secret is that of an account at the broker, which has a certificate, too."""
    return f"{secret}-".startswith("broker-account-")


def named_paths(value: Any) -> list[str]:
    if isinstance(value, dict):
        return [path for item in value.values() for path in named_paths(item)]
    if isinstance(value, list):
        return [path for item in value for path in named_paths(item)]
    return [value] if isinstance(value, str) and value.startswith("/var/run/secrets/") else []


def test_what_must_stay_is_kept(official: Any) -> None:
    kept = {
        (o["kind"], o["metadata"].get("namespace"), o["metadata"]["name"])
        for o in official.objects
        if o["metadata"].get("annotations", {}).get("helm.sh/resource-policy") == "keep"
    }
    assert kept == {
        ("CustomResourceDefinition", None, "taskdescriptions.robotkube.io"),
        ("CustomResourceDefinition", None, "inspections.robotkube.io"),
        ("ConfigMap", None, "broker-certificates"),
        ("Secret", None, "robotkube-seed"),
        ("Secret", None, "tls-authority"),
        ("Secret", None, "broker-tls"),
        ("Secret", None, "database-tls"),
        ("Secret", None, "forge-tls"),
        ("Secret", None, "manager-tls"),
        ("Secret", None, "rights-tls"),
        ("Secret", None, "suite-runner-tls"),
        ("Secret", "robotkube-gate", "gate-tls"),
        ("Namespace", None, "robotkube-gate"),
        ("Lease", None, "robotkube-manager-manager"),
        ("PersistentVolumeClaim", "robotkube-suite-0", "scratch"),
        ("PersistentVolumeClaim", "robotkube-suite-1", "scratch"),
        ("Namespace", None, "robotkube-suite-0"),
        ("Namespace", None, "robotkube-suite-1"),
        ("PersistentVolumeClaim", None, "database"),
        ("PersistentVolumeClaim", None, "forge"),
        ("PersistentVolumeClaim", "vehicle-00", "bags"),
        ("PersistentVolumeClaim", "cloud-0", "recordings"),
        ("Namespace", None, "vehicle-00"),
        ("Namespace", None, "cloud-0"),
    }


def passwords(rendered: Any) -> list[str]:
    secrets = [secret.get("stringData", {}) for secret in rendered.of_kind("Secret")]
    return [secret["password"] for secret in secrets if "password" in secret]


def test_each_agent_has_a_password_of_its_own(official: Any) -> None:
    secrets = passwords(official)
    given = {secret for secret in secrets if secrets.count(secret) == 1}
    assert all(len(secret) == 60 for secret in secrets)
    # Written twice on purpose: the forge's accounts argocd (forge, charts, deployment) and gate (bootstrap, the gate),
    # and a recorder's database account.
    assert len(set(secrets) - given) == 3
    assert official.one("Secret", "broker-account", "vehicle-00")["stringData"]["password"] in given


def test_an_agent_gets_another_password_and_the_others_keep_theirs(helm: Any) -> None:
    def accounts(**more: int) -> dict[str, str]:
        profile = PROFILE.with_name("official.yaml")
        agents = yaml.safe_load(profile.read_text())["agents"]
        agents = [{**agent, **(more if agent["name"] == "vehicle-00" else {})} for agent in agents]
        rendered = helm.template(PLATFORM, profile, agents=agents)
        lines = rendered.one("Secret", "broker-accounts")["stringData"]["passwords"].split()
        hashes = dict(line.split(":") for line in lines)
        for agent in agents:
            own = rendered.one("Secret", "broker-account", agent["name"])["stringData"]["password"]
            assert hashes[agent["name"]] == own
        return hashes

    before, same, after = accounts(), accounts(brokerPasswordNumber=0), accounts(brokerPasswordNumber=1)
    assert before == same
    assert {name for name in before if before[name] != after[name]} == {"vehicle-00"}
    assert accounts(brokerPasswordNumber=2)["vehicle-00"] not in (before["vehicle-00"], after["vehicle-00"])


def test_another_seed_gives_other_passwords(helm: Any, official: Any) -> None:
    other = helm.template(PLATFORM, PROFILE, secrets={"seed": "another-seed-of-thirty-two-characters"})
    assert not set(passwords(official)) & set(passwords(other))


def test_without_a_seed_one_is_made_and_used_throughout(helm: Any) -> None:
    first = helm.template(PLATFORM, PROFILE, secrets={"seed": ""})
    helm.done.clear()  # so that it is rendered again
    second = helm.template(PLATFORM, PROFILE, secrets={"seed": ""})
    seeds = [rendered.one("Secret", "robotkube-seed")["stringData"]["seed"] for rendered in (first, second)]
    assert [len(seed) for seed in seeds] == [64, 64]
    assert seeds[0] != seeds[1]
    forge = first.one("Secret", "forge-account-argocd")["stringData"]["password"]
    assert first.one("Secret", "robotkube-charts", "argocd")["stringData"]["password"] == forge


@pytest.mark.parametrize("chart", APP_CHARTS)
def test_a_node_that_is_named_is_selected_and_told_to_the_process(helm: Any, chart: str) -> None:
    profile = PROFILE.with_name(f"{chart}.yaml")
    placement = {"agent": "edge-0", "node": "edge-0-b", "movable": True}
    rendering = helm.template(CHARTS / "apps" / chart, profile, release=chart, placement=placement)
    (deployment,), (settings,) = rendering.of_kind("Deployment"), rendering.of_kind("ConfigMap")
    selector = deployment["spec"]["template"]["spec"]["nodeSelector"]
    assert selector == {"robotkube.io/agent": "edge-0", "kubernetes.io/hostname": "edge-0-b"}
    assert {key: settings["data"][key] for key in ("node", "movable")} == {"node": "edge-0-b", "movable": "true"}
