"""Who holds the key of the gate, what the suite-runner may do and where, and a platform that publishes nothing."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.stages.paths import CHARTS
from tests.stages.settings_mounted import GATE, KEY_SECRETS

pytestmark = pytest.mark.toolchain

PLATFORM = CHARTS / "robotkube"
PROFILE = Path(__file__).parent / "profiles" / "official.yaml"
TEST_NAMESPACES = ("robotkube-suite-0", "robotkube-suite-1")
CERTIFICATES = {
    "tls-authority",
    "broker-account",
    *(f"{name}-tls" for name in ("broker", "database", "forge", "gate", "manager", "rights", "suite-runner")),
}  # what the process that keeps certificates fills
GATE_KEYS = {"official": "gate-key", "embedded": "kept-gate-key"}

Object = dict[str, Any]


@pytest.fixture(params=sorted(GATE_KEYS))
def profile(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def platform(request: pytest.FixtureRequest, profile: str) -> Any:
    return request.getfixturevalue(profile)


def test_only_the_gate_mounts_the_key_and_stands_where_it_is(platform: Any, profile: str) -> None:
    name = GATE_KEYS[profile]
    own = {}
    for workload in platform.of_kind("Deployment", "StatefulSet", "Job"):
        text = json.dumps(workload["spec"]["template"]["spec"]["volumes"])
        own[workload["metadata"]["name"]] = (workload["metadata"].get("namespace"), f'"{name}"' in text)
    assert {process for process, (namespace, _) in own.items() if namespace == GATE} == {"gate"}
    assert own.pop("gate") == (GATE, True)
    mounting = {process for process, (_, mounts) in own.items() if mounts}
    # What an older installation has under this name, in the platform's namespace, is moved by the Job.
    assert {process.rpartition("-")[0] for process in mounting} <= {"gate-key"}
    optional = {"Deployment/remover", "Deployment/console"} & set(dict(platform.pods))
    assert len(platform.pods) == 12 + len(optional) + len(mounting)


def test_the_namespace_of_the_gate_holds_what_the_gate_needs(platform: Any) -> None:
    labels = platform.one("Namespace", GATE)["metadata"]["labels"]
    assert labels["pod-security.kubernetes.io/enforce"] == "restricted"
    there = {(o["kind"], o["metadata"]["name"]) for o in platform.objects if o["metadata"].get("namespace") == GATE}
    secrets = {name for kind, name in there if kind == "Secret"}
    mounted = {
        source["secret"]["name"]
        for volume in dict(platform.pods)["Deployment/gate"]["volumes"]
        for source in volume.get("projected", {}).get("sources", [])
        if "secret" in source
    }
    assert secrets == mounted - set(KEY_SECRETS)
    kinds = {kind for kind, _ in there} - {"Secret", "Role", "RoleBinding"}
    assert kinds == {"ConfigMap", "Deployment", "NetworkPolicy", "Service", "ServiceAccount"}


def of_account(name: str) -> str:
    """The Secret of any account at the broker as that of one: who makes their certificates reads them all."""
    return "broker-account" if name.startswith("broker-account-") else name


def test_no_account_may_read_secrets_where_the_key_is(platform: Any) -> None:
    for role in platform.of_kind("Role", "ClusterRole"):
        if role["kind"] == "ClusterRole" or role["metadata"].get("namespace") in (None, "robotkube", GATE):
            rules = [rule for rule in role["rules"] if "secrets" in rule["resources"]]
            rules = [
                rule for rule in rules if not set(map(of_account, rule.get("resourceNames") or ["*"])) <= CERTIFICATES
            ]
            assert [rule["verbs"] for rule in rules] in ([], [["create"]])
    known = {(role["kind"], role["metadata"]["name"]) for role in platform.of_kind("Role", "ClusterRole")}
    for binding in platform.of_kind("RoleBinding", "ClusterRoleBinding"):
        assert (binding["roleRef"]["kind"], binding["roleRef"]["name"]) in known


def test_no_key_and_nothing_of_one_is_in_what_helm_keeps(platform: Any) -> None:
    assert "PRIVATE KEY" not in platform.text
    assert [o for o in platform.of_kind("Secret") if o["metadata"]["name"] in KEY_SECRETS] == []


def test_a_key_that_is_given_is_made_by_nobody(embedded: Any) -> None:
    assert [o["metadata"]["name"] for o in embedded.objects if o["metadata"]["name"].startswith("gate-key")] == []
    keys = embedded.one("ConfigMap", "evidence-keys")["data"]
    assert keys == embedded.one("ConfigMap", "evidence-keys", GATE)["data"]
    assert list(keys) == ["embedded.pem"]
    assert keys["embedded.pem"].startswith("-----BEGIN PUBLIC KEY-----\n")


READERS = {"gate": GATE, "manager": None, "inspector": None}  # who verifies signatures, and where


def test_all_who_verify_take_keys_from_the_same_place(platform: Any, profile: str) -> None:
    names = ["evidence-keys", *(["gate-public-key"] if profile == "official" else [])]
    assert_reading(platform, READERS, names)


def test_admission_takes_keys_from_there_as_well(helm: Any) -> None:
    """The made one too: it would list nothing that the gate signed."""
    rendered = helm.template(PLATFORM, PROFILE, PROFILE.with_name("admission.yaml"))
    assert_reading(rendered, {**READERS, "admission": None}, ["evidence-keys", "gate-public-key"])


def assert_reading(rendered: Any, readers: Mapping[str, str | None], names: Sequence[str]) -> None:
    """These processes, and no others, mount the keys of these ConfigMaps where their settings say."""
    pods = dict(rendered.pods)
    volume = {"name": "keys", "projected": {"sources": [{"configMap": {"name": name}} for name in names]}}
    mounting = {where for where, pod in pods.items() if volume in pod["volumes"]}
    assert mounting == {f"Deployment/{process}" for process in readers}
    for process, namespace in readers.items():
        settings = yaml.safe_load(rendered.one("ConfigMap", process, namespace)["data"]["config.yaml"])
        assert settings["evidence"]["keys"] == "/etc/robotkube/keys"
        mounts = pods[f"Deployment/{process}"]["containers"][0]["volumeMounts"]
        assert {"name": "keys", "mountPath": "/etc/robotkube/keys", "readOnly": True} in mounts


def test_a_second_trusted_key_restarts_who_reads_it(helm: Any, embedded: Any) -> None:
    [pem] = embedded.one("ConfigMap", "evidence-keys")["data"].values()
    files = (PLATFORM / "values-embedded.yaml", PROFILE.with_name("embedded.yaml"))
    after = helm.template(PLATFORM, *files, evidence={"trustedKeys": {"next": pem}})
    for name, namespace in READERS.items():
        assert list(after.one("ConfigMap", "evidence-keys", namespace)["data"]) == ["embedded.pem", "next.pem"]
        old, new = (rendering.one("Deployment", name, namespace)["spec"]["template"] for rendering in (embedded, after))
        assert old["metadata"]["annotations"] != new["metadata"]["annotations"]
        assert old["spec"] == new["spec"]


def test_another_pod_of_the_key_is_another_job(helm: Any, official: Any) -> None:
    """A Job's pods cannot be changed: an upgrade with the same name and another pod would be refused."""

    def job(**values: Any) -> Object:
        [key_job] = [
            o for o in helm.template(PLATFORM, PROFILE, **values).of_kind("Job") if "gate-key" in str(o["spec"])
        ]
        return dict(key_job)

    [same] = [o for o in official.of_kind("Job") if o["metadata"]["name"].startswith("gate-key-")]
    assert job() == same
    assert "helm.sh/hook" not in same["metadata"].get("annotations", {}), "hooks wait for what waits for the key"
    image = "registry.example/robotkube/platform@sha256:" + "7" * 64
    for other in (job(images={"platform": image}), job(gate={"namespace": "signing"}), job(logLevel="debug")):
        assert other["metadata"]["name"] != same["metadata"]["name"]
        assert other["spec"] != same["spec"]


def test_the_gate_stands_where_values_say(helm: Any) -> None:
    rendered = helm.template(PLATFORM, PROFILE, gate={"namespace": "signing"})
    assert "robotkube-gate" not in {o["metadata"].get("namespace") for o in rendered.objects}
    assert rendered.one("Deployment", "gate", "signing")
    settings = yaml.safe_load(rendered.one("ConfigMap", "manager")["data"]["config.yaml"])
    assert settings["gate"]["objects"].startswith("https://gate.signing.svc.cluster.local:8080/")


def test_webhooks_to_where_the_gate_stood_before_go(official: Any) -> None:
    forge = yaml.safe_load(official.one("ConfigMap", "bootstrap")["data"]["config.yaml"])["forge"]
    called = {hook["url"] for hook in forge["webhooks"]}
    former = {hook["url"] for hook in forge["former_webhooks"]}
    assert "https://gate.robotkube-gate.svc.cluster.local:8080/webhook" in called
    by_http = {url.replace("https:", "http:") for url in called}  # of tls.processes, which is on here
    assert former == {"http://gate.robotkube.svc.cluster.local:8080/webhook", *by_http}
    assert {hook["repository"] for hook in forge["former_webhooks"]} == {r["name"] for r in forge["repositories"]}


def test_on_an_external_forge_the_gates_secrets_stand_with_the_gate_alone(helm: Any) -> None:
    external = {"kind": "external", "external": {"url": "https://git.example"}}
    rendered = helm.template(PLATFORM, PROFILE, forge=external)
    for name in ("forge-account-gate", "forge-webhook-gate"):
        assert [o["metadata"].get("namespace") for o in rendered.objects if o["metadata"]["name"] == name] == [GATE]


def test_the_suite_runner_may_do_its_work_in_its_namespaces_and_elsewhere_read_numbers(platform: Any) -> None:
    bound = {
        (binding["metadata"].get("namespace"), binding["roleRef"]["name"])
        for binding in platform.of_kind("RoleBinding", "ClusterRoleBinding")
        if any(s["name"] == "suite-runner" for s in binding["subjects"])
    }
    assert bound == {(None, "robotkube-suite-runner"), *((name, "suite-runner") for name in TEST_NAMESPACES)}
    for namespace in TEST_NAMESPACES:
        rules = platform.one("Role", "suite-runner", namespace)["rules"]
        granted = {resource: set(rule["verbs"]) for rule in rules for resource in rule["resources"]}
        assert set(granted) == {"deployments", "configmaps", "pods", "pods/log", "secrets", "events"}
        assert granted["secrets"] == {"create", "delete"}
        assert granted["pods/log"] == {"get"}
        assert granted["events"] == {"list"}


def test_a_test_namespace_takes_restricted_pods_and_holds_no_secret(platform: Any) -> None:
    for namespace in TEST_NAMESPACES:
        labels = platform.one("Namespace", namespace)["metadata"]["labels"]
        assert labels["pod-security.kubernetes.io/enforce"] == "restricted"
        there = [o for o in platform.objects if o["metadata"].get("namespace") == namespace]
        peers = [o["metadata"]["name"] for o in there if o["kind"] == "Service"]
        assert peers in ([], ["ros-peers"])
        assert sorted({o["kind"] for o in there}) == [
            "LimitRange",
            "NetworkPolicy",
            "PersistentVolumeClaim",
            "ResourceQuota",
            "Role",
            "RoleBinding",
            *(["Service"] if peers else []),
            "ServiceAccount",
        ]
        accounts = [o for o in there if o["kind"] == "ServiceAccount"]
        names = {account["metadata"]["name"] for account in accounts}
        assert names == {"application", "mqtt-bridge", "event-detector", "bag-player"}
        assert not any(account["automountServiceAccountToken"] for account in accounts)


def test_the_suite_runner_gets_a_token_of_the_cluster_and_no_key(platform: Any) -> None:
    pod = dict(platform.pods)["Deployment/suite-runner"]
    assert pod["automountServiceAccountToken"] is True
    assert pod["serviceAccountName"] == "suite-runner"
    [volume] = [volume for volume in pod["volumes"] if "projected" in volume]
    mounted = {source["secret"]["name"] for source in volume["projected"]["sources"]}
    assert mounted == {"forge-account-suite-runner", "suite-runner-token", "suite-runner-tls"}


def test_test_namespaces_have_a_ros_domain_each(helm: Any) -> None:
    rendered = helm.template(PLATFORM, PROFILE, suites={"pool": 3})
    settings = yaml.safe_load(rendered.one("ConfigMap", "suite-runner")["data"]["config.yaml"])
    assert settings["test_namespaces"] == [{"namespace": f"robotkube-suite-{i}", "domain_id": 90 + i} for i in range(3)]
    assert settings["agent"] == "cloud-0"


def limits(rendered: Any) -> tuple[str, str, str]:
    """CPU and memory that a test namespace's pods may request together, and memory that one container may have."""
    hard = rendered.one("ResourceQuota", "test-namespace", TEST_NAMESPACES[0])["spec"]["hard"]
    [limit] = rendered.one("LimitRange", "test-namespace", TEST_NAMESPACES[0])["spec"]["limits"]
    return hard["requests.cpu"], hard["requests.memory"], limit["max"]["memory"]


def test_the_limits_are_those_that_the_schema_states(platform: Any) -> None:
    stated = json.loads((PLATFORM / "values.schema.json").read_text())["properties"]["suites"]["properties"]
    defaults = [stated["testNamespace"]["properties"][key]["default"] for key in ("cpu", "memory", "memory")]
    assert limits(platform) == ("1", "4Gi", "4Gi") == tuple(defaults)


def test_the_former_name_of_the_limits_counts_with_a_warning(helm: Any, tmp_path: Path) -> None:
    assert limits(helm.template(PLATFORM, PROFILE, suites={"testNamespace": {"cpu": "3"}})) == ("3", "4Gi", "4Gi")
    one_each = {"testNamespace": {"cpu": "3"}, "room": {"memory": "8Gi"}}
    assert limits(helm.template(PLATFORM, PROFILE, suites=one_each)) == ("3", "8Gi", "8Gi")
    the_same = {"testNamespace": {"cpu": "2"}, "room": {"cpu": "2"}}
    assert limits(helm.template(PLATFORM, PROFILE, suites=the_same)) == ("2", "4Gi", "4Gi")
    instead = {"testNamespace": None, "room": {"cpu": "2", "memory": "8Gi"}}
    assert limits(helm.template(PLATFORM, PROFILE, suites=instead)) == ("2", "8Gi", "8Gi")
    former = {"suites": {"room": {"cpu": "2", "memory": "8Gi"}}}
    assert limits(helm.template(PLATFORM, PROFILE, **former)) == ("2", "8Gi", "8Gi")
    assert "WARNING: the value suites.room has another name, suites.testNamespace" in notes(helm, former, tmp_path)
    present = {"suites": {"testNamespace": {"cpu": "2"}}}
    assert "WARNING" not in notes(helm, present, tmp_path)
    plain = {"tls": {"processes": False}}
    assert "WARNING: gate, managers, suite-runner, rights speak HTTP:" in notes(helm, plain, tmp_path)


def test_who_may_sign_in_at_the_console_and_where_is_said(helm: Any, tmp_path: Path) -> None:
    elsewhere = notes(helm, {}, tmp_path)
    assert "The console is at" not in elsewhere
    assert "port-forward" not in elsewhere
    nobody = {"console": {"signIn": {"issuer": "", "clientId": "", "url": "", "groups": []}}}
    assert "kubectl -n robotkube port-forward service/console 8080          then" in notes(helm, nobody, tmp_path)
    by_forge = yaml.safe_load(PROFILE.with_name("forge-sign-in.yaml").read_text())
    said = notes(helm, by_forge, tmp_path)
    assert (
        "The console is at https://console.example. People sign in by their accounts of the forge, at https://f" in said
    )
    assert "; members of robotkube:deployment-write read." in said
    unreachable = (
        "NOTE: networkPolicies.clients.console and .forge name who reaches the two, and one of them names nobody"
    )
    assert unreachable in said
    browsers = [{"ipBlock": {"cidr": "192.0.2.10/32"}}]
    clients = {"console": browsers, "forge": browsers}
    assert unreachable not in notes(helm, {**by_forge, "networkPolicies": {"clients": clients}}, tmp_path)


def notes(helm: Any, values: dict[str, Any], folder: Path) -> str:
    """What helm prints after an installation with these values: NOTES.txt as a template of a copy of the chart."""
    chart = folder / "robotkube"
    shutil.copytree(PLATFORM, chart, dirs_exist_ok=True)
    text = (PLATFORM / "templates" / "NOTES.txt").read_text()
    (chart / "templates" / "notes.yaml").write_text(
        '{{- define "notes" }}' + text + '{{ end }}\nnotes: {{ include "notes" . | toJson }}\n'
    )
    options = ("--show-only", "templates/notes.yaml", "-f", str(PROFILE), "-f", str(helm.values(values)))
    done = helm.run("template", "robotkube", str(chart), *options)
    assert done.returncode == 0, done.stderr
    return str(yaml.safe_load(done.stdout)["notes"])


def test_suites_start_a_database_of_the_platforms_kind(helm: Any, embedded: Any) -> None:
    settings = yaml.safe_load(embedded.one("ConfigMap", "suite-runner")["data"]["config.yaml"])
    assert settings["database"]["kind"] == "ferretdb"
    assert "--handler=sqlite" in settings["database"]["arguments"]


def test_what_one_makes_at_broker_and_database_of_others_is_said(helm: Any, tmp_path: Path) -> None:
    assert "NOTE: make at" not in notes(helm, {}, tmp_path)
    broker = {"kind": "external", "external": {"host": "mqtt.example", "port": 8883}}
    database = {"kind": "external", "external": {"host": "mongo.example"}}
    said = notes(helm, {"broker": broker, "database": database, "tls": {"mode": "off"}}, tmp_path)
    assert (
        "NOTE: make at mqtt.example the accounts of the Secrets broker-account in the namespace of each agent" in said
    )
    assert "here broker-account-manager, and for who measures broker-account-observer (" in said
    assert "NOTE: make at mongo.example the account of the Secret database-account" in said
    refused = "NOTE: suites have no database to start and refuse charts that name an account of one."
    assert refused not in said
    assert refused in notes(helm, {"database": database, "images": {"mongo": ""}}, tmp_path)


@pytest.mark.parametrize(
    ("ferretdb", "mongo", "admission", "kind"),
    [
        ("registry.example/ferretdb:1", "registry.example/mongo:8", False, "ferretdb"),
        ("", "registry.example/mongo:8", False, "mongo"),
        ("", f"registry.example/mongo@sha256:{'7' * 64}", True, "mongo"),
        ("", "registry.example/mongo:8", True, ""),  # admission would not let it run
        ("", "", False, ""),
    ],
)
def test_beside_a_database_of_others_suites_start_one_whose_image_is_given(
    helm: Any, ferretdb: str, mongo: str, admission: bool, kind: str
) -> None:
    database = {"kind": "external", "external": {"host": "mongo.example"}}
    pinned = {name: f"registry.example/{name}@sha256:{'8' * 64}" for name in ("mosquitto", "gitea")}
    values = {"images": {**pinned, "ferretdb": ferretdb, "mongo": mongo}, "admission": {"enabled": admission}}
    rendered = helm.template(PLATFORM, PROFILE, database=database, **values)
    settings = yaml.safe_load(rendered.one("ConfigMap", "suite-runner")["data"]["config.yaml"])
    assert settings["database"]["kind"] == kind
    image = {"ferretdb": ferretdb, "mongo": mongo, "": ""}[kind]
    assert settings["images"]["database"] == image
    known = yaml.safe_load(rendered.one("ConfigMap", "inspector")["data"]["config.yaml"])["images"]
    assert (mongo in known) == (kind == "mongo")


def test_images_can_be_looked_up_by_name(embedded: Any) -> None:
    images = yaml.safe_load(embedded.one("ConfigMap", "platform-images")["data"]["images.yaml"])
    assert {"platform", "ros", "suites", "mosquitto", "gitea", "ferretdb"} <= set(images)
    assert all(images.values())


def test_images_of_services_can_be_looked_up_and_are_not_the_platforms(helm: Any, embedded: Any) -> None:
    assert "services.yaml" not in embedded.one("ConfigMap", "platform-images")["data"]
    reference = f"registry.example/mqtt-bridge@sha256:{'9' * 64}"
    rendered = helm.template(PLATFORM, PROFILE, serviceImages={"mqtt-bridge": reference})
    listed = rendered.one("ConfigMap", "platform-images")["data"]
    assert yaml.safe_load(listed["services.yaml"]) == {"mqtt-bridge": reference}
    assert rendered.text.count(reference) == 1, "no pod, no admission list, no inspection has it"
    refusal = helm.refusal(PLATFORM, PROFILE, serviceImages={"mqtt-bridge": "registry.example/mqtt-bridge:1"})
    assert "serviceImages" in refusal


def test_without_suites_nothing_runs_charts_and_the_gate_knows(helm: Any) -> None:
    rendered = helm.template(PLATFORM, PROFILE, suites={"enabled": False}, images={"suites": "", "ros": ""})
    assert "suite-runner" not in {where.partition("/")[2] for where, _ in rendered.pods}
    named = {o["metadata"]["name"] for o in rendered.objects if o["kind"] not in ("Secret", "ConfigMap")}
    assert not [name for name in named if "suite" in name]
    assert "suites" not in yaml.safe_load(rendered.one("ConfigMap", "gate", GATE)["data"]["config.yaml"])
    assert "suite-runner-token" not in json.dumps(dict(rendered.pods)["Deployment/gate"])
