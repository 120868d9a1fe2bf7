"""Who holds the key of the gate, what the suite-runner may do and where, and a platform that publishes nothing."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from cryptography.x509 import load_pem_x509_certificate

from robotkube.registry.evidence.adapters.dsse import KeyFile, TrustedKeys
from tests.stages.paths import CHARTS
from tests.stages.registry.signed_evidence import Signing, artefact

pytestmark = pytest.mark.toolchain

PLATFORM = CHARTS / "robotkube"
PROFILE = Path(__file__).parent / "profiles" / "official.yaml"
TEST_NAMESPACES = ("robotkube-suite-0", "robotkube-suite-1")
GATE_KEYS = {"official": "gate-key", "embedded": "kept-gate-key"}

Object = dict[str, Any]


@pytest.fixture(params=sorted(GATE_KEYS))
def profile(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def platform(request: pytest.FixtureRequest, profile: str) -> Any:
    return request.getfixturevalue(profile)


def test_only_the_gate_mounts_the_key(platform: Any, profile: str) -> None:
    name = GATE_KEYS[profile]
    assert [where for where, pod in platform.pods if name in json.dumps(pod)] == ["Deployment/gate"]
    assert len(platform.pods) == 8


def test_no_account_may_read_secrets_where_the_key_is(platform: Any) -> None:
    for role in platform.of_kind("Role", "ClusterRole"):
        if role["kind"] == "ClusterRole" or role["metadata"].get("namespace") in (None, "robotkube"):
            assert not [rule for rule in role["rules"] if "secrets" in rule["resources"]]
    known = {(role["kind"], role["metadata"]["name"]) for role in platform.of_kind("Role", "ClusterRole")}
    for binding in platform.of_kind("RoleBinding", "ClusterRoleBinding"):
        assert (binding["roleRef"]["kind"], binding["roleRef"]["name"]) in known


def test_the_made_key_stands_nowhere_but_in_its_secret(official: Any) -> None:
    pair = official.one("Secret", "gate-key")["stringData"]
    key = load_pem_private_key(pair["key.pem"].encode(), None)
    assert isinstance(key, Ed25519PrivateKey)
    body = pair["key.pem"].splitlines()[1]
    assert official.text.count(body) == 1
    assert official.text.count("PRIVATE KEY-----") == 2
    keys = official.one("ConfigMap", "evidence-keys")["data"]
    assert list(keys) == ["gate.pem"]
    assert keys["gate.pem"] == pair["certificate.pem"]
    assert load_pem_x509_certificate(keys["gate.pem"].encode()).public_key() == key.public_key()


def test_the_made_key_signs_what_its_certificate_verifies(official: Any, tmp_path: Path) -> None:
    (tmp_path / "key").write_text(official.one("Secret", "gate-key")["stringData"]["key.pem"])
    (tmp_path / "gate.pem").write_text(official.one("ConfigMap", "evidence-keys")["data"]["gate.pem"])
    key, trusted = KeyFile(tmp_path / "key"), TrustedKeys(tmp_path)
    envelopes = Signing(key).sign(artefact())
    assert {trusted.verify(data).key_id for data in envelopes.values()} == {key.key_id}


def test_a_given_key_is_named_and_its_public_half_trusted(embedded: Any) -> None:
    assert "PRIVATE KEY" not in embedded.text
    assert [o for o in embedded.of_kind("Secret") if o["metadata"]["name"] == "gate-key"] == []
    keys = embedded.one("ConfigMap", "evidence-keys")["data"]
    assert list(keys) == ["embedded.pem"]
    assert keys["embedded.pem"].startswith("-----BEGIN PUBLIC KEY-----\n")


def test_gate_and_manager_take_keys_from_the_same_place(platform: Any) -> None:
    pods = dict(platform.pods)
    mounting = {
        where
        for where, pod in pods.items()
        if {"name": "keys", "configMap": {"name": "evidence-keys"}} in pod["volumes"]
    }
    assert mounting == {"Deployment/gate", "Deployment/manager"}
    for process in ("gate", "manager"):
        settings = yaml.safe_load(platform.one("ConfigMap", process)["data"]["config.yaml"])
        assert settings["evidence"]["keys"] == "/etc/robotkube/keys"
        mounts = pods[f"Deployment/{process}"]["containers"][0]["volumeMounts"]
        assert {"name": "keys", "mountPath": "/etc/robotkube/keys", "readOnly": True} in mounts


def test_a_second_trusted_key_restarts_who_reads_it(helm: Any, embedded: Any) -> None:
    [pem] = embedded.one("ConfigMap", "evidence-keys")["data"].values()
    files = (PLATFORM / "values-embedded.yaml", PROFILE.with_name("embedded.yaml"))
    after = helm.template(PLATFORM, *files, evidence={"trustedKeys": {"next": pem}})
    assert list(after.one("ConfigMap", "evidence-keys")["data"]) == ["embedded.pem", "next.pem"]
    for name in ("gate", "manager"):
        old, new = (found.one("Deployment", name)["spec"]["template"] for found in (embedded, after))
        assert old["metadata"]["annotations"] != new["metadata"]["annotations"]
        assert old["spec"] == new["spec"]


def test_the_suite_runner_may_do_its_work_in_its_namespaces_and_nothing_elsewhere(platform: Any) -> None:
    bound = [
        (binding["metadata"].get("namespace"), binding["roleRef"]["name"])
        for binding in platform.of_kind("RoleBinding", "ClusterRoleBinding")
        if any(s["name"] == "suite-runner" for s in binding["subjects"])
    ]
    assert bound == [(namespace, "suite-runner") for namespace in TEST_NAMESPACES]
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
        assert sorted({o["kind"] for o in there}) == [
            "LimitRange",
            "NetworkPolicy",
            "PersistentVolumeClaim",
            "ResourceQuota",
            "Role",
            "RoleBinding",
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
    assert mounted == {"forge-account-suite-runner", "suite-runner-token"}


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


def test_the_former_name_of_the_limits_counts_with_a_warning(helm: Any, platform: Any, tmp_path: Path) -> None:
    stated = json.loads((PLATFORM / "values.schema.json").read_text())["properties"]["suites"]["properties"]
    defaults = [stated["testNamespace"]["properties"][key]["default"] for key in ("cpu", "memory", "memory")]
    assert limits(platform) == ("1", "4Gi", "4Gi") == tuple(defaults)
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
    assert "WARNING" not in notes(helm, {"suites": {"testNamespace": {"cpu": "2"}}}, tmp_path)


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


def test_suites_start_a_database_of_the_platforms_kind_or_none(helm: Any, embedded: Any) -> None:
    settings = yaml.safe_load(embedded.one("ConfigMap", "suite-runner")["data"]["config.yaml"])
    assert settings["database"]["kind"] == "ferretdb"
    assert "--handler=sqlite" in settings["database"]["arguments"]
    database = {"kind": "external", "external": {"host": "mongo.example"}}
    rendered = helm.template(PLATFORM, PROFILE, database=database)
    settings = yaml.safe_load(rendered.one("ConfigMap", "suite-runner")["data"]["config.yaml"])
    assert settings["database"] == {"kind": "", "arguments": []}
    assert settings["images"]["database"] == ""


def test_images_can_be_looked_up_by_name(embedded: Any) -> None:
    images = yaml.safe_load(embedded.one("ConfigMap", "platform-images")["data"]["images.yaml"])
    assert {"platform", "ros", "suites", "mosquitto", "gitea", "ferretdb"} <= set(images)
    assert all(images.values())


def test_without_suites_nothing_runs_charts_and_the_gate_knows(helm: Any) -> None:
    rendered = helm.template(PLATFORM, PROFILE, suites={"enabled": False}, images={"suites": "", "ros": ""})
    assert "suite-runner" not in {where.partition("/")[2] for where, _ in rendered.pods}
    named = {o["metadata"]["name"] for o in rendered.objects if o["kind"] not in ("Secret", "ConfigMap")}
    assert not [name for name in named if "suite" in name]
    assert "suites" not in yaml.safe_load(rendered.one("ConfigMap", "gate")["data"]["config.yaml"])
    assert "suite-runner-token" not in json.dumps(dict(rendered.pods)["Deployment/gate"])
