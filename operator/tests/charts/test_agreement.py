"""Charts and programs agree: what a chart writes, its reader accepts; what packing makes, Helm renders."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml

from robotkube.delivery.console import settings as console
from robotkube.delivery.console.core.asking import Writers
from robotkube.delivery.deployment.core.policies.initial import InitialPolicy, read_initial_policy
from robotkube.delivery.gate import __main__ as gate
from robotkube.delivery.inspection import __main__ as inspector
from robotkube.delivery.manager import __main__ as manager
from robotkube.delivery.removal import __main__ as remover
from robotkube.delivery.removal.core.targets import RemovalPolicy
from robotkube.delivery.rights import settings as rights
from robotkube.errors import InputError
from robotkube.foundation.runtime.settings_file import read_settings
from robotkube.registry.catalogue.core.catalogue import read_release_policy
from robotkube.registry.charts.adapters.chart_folders import pack
from robotkube.registry.evidence.core.verification_policy import read_verification_policy
from robotkube.registry.suites import __main__ as suite_runner
from robotkube.robots.bags.core.playback import read_player_settings
from robotkube.robots.bridge.core.settings import read_bridge_settings
from robotkube.robots.detector.core.settings import read_detector_settings
from robotkube.robots.perception.core.detection_settings import read_detection_settings
from robotkube.robots.perception.core.tracking_settings import read_tracking_settings
from robotkube.setup import bootstrap, gate_key, installation_test, teardown
from robotkube.setup.loops.bootstrap import plan_teams
from tests.stages.forge.installation import ACCOUNTS, PACKAGES, VIEWER
from tests.stages.paths import CHARTS, DOCS
from tests.stages.registry import chart_images
from tests.stages.settings_mounted import GATE, mounted, write

pytestmark = pytest.mark.toolchain

PROFILES = Path(__file__).parent / "profiles"
GATE_URL = "https://gate.robotkube-gate.svc.cluster.local:8080"
PROCESSES: dict[str, Any] = {
    "bootstrap": bootstrap,
    "gate": gate,
    "inspector": inspector,
    "installation-test": installation_test,
    "manager": manager,
    "rights": rights,
    "suite-runner": suite_runner,
    "teardown": teardown,
}
APPS: dict[str, Callable[[Mapping[str, Any], str], Any]] = {
    "bag-player": read_player_settings,
    "event-detector": read_detector_settings,
    "mqtt-bridge": read_bridge_settings,
    "object-detection": read_detection_settings,
    "object-tracking": read_tracking_settings,
}


@pytest.mark.parametrize("profile", ["official", "embedded"])
@pytest.mark.parametrize("process", PROCESSES)
def test_processes_read_the_settings_the_chart_writes(
    request: pytest.FixtureRequest, tmp_path: Path, process: str, profile: str
) -> None:
    path = mounted(request.getfixturevalue(profile), process, tmp_path)
    assert read_settings(path, PROCESSES[process].read_configuration)


def test_the_remover_reads_the_settings_the_chart_writes(official: Any, tmp_path: Path) -> None:
    settings = read_settings(mounted(official, "remover", tmp_path), remover.read_configuration)
    assert settings.policy == RemovalPolicy(frozenset({"vehicle-00", "vehicle-01", "cloud-0"}))
    assert settings.namespace == "robotkube"
    [container] = dict(official.pods)["Deployment/remover"]["containers"]
    assert container["ports"] == [{"name": "health", "containerPort": settings.listen.port}]


def test_the_console_reads_the_settings_the_chart_writes(helm: Any, official: Any, tmp_path: Path) -> None:
    settings = read_settings(mounted(official, "console", tmp_path), console.read_configuration)
    assert settings.sign_in is not None
    assert settings.writers == ()
    assert settings.sign_in.redirect == "https://console.example/auth/callback"
    assert {"console.example", "localhost", "console.robotkube.svc.cluster.local"} <= settings.hosts
    assert settings.poses is not None
    assert settings.poses.broker.username == "observer"
    [container] = dict(official.pods)["Deployment/console"]["containers"]
    ports = {port["name"]: port["containerPort"] for port in container["ports"]}
    assert ports == {"http": settings.listen.port, "health": settings.listen.health_port}
    rendered = helm.template(CHARTS / "robotkube", *(PROFILES / f"{name}.yaml" for name in ("official", "writers")))
    settings = read_settings(mounted(rendered, "console", tmp_path / "writers"), console.read_configuration)
    assert settings.writers == (Writers("robotkube:operators", frozenset(["cloud-0"])),)
    anybody: Any = {"enabled": True, "anybodyReads": True, "signIn": {"issuer": ""}}
    elsewhere: Any = {"broker": {"kind": "external", "external": {"host": "mqtt.example"}}, "tls": {"mode": "off"}}
    rendered = helm.template(CHARTS / "robotkube", PROFILES / "official.yaml", console=anybody, **elsewhere)
    settings = read_settings(mounted(rendered, "console", tmp_path / "other"), console.read_configuration)
    assert (settings.sign_in, settings.poses) == (None, None)
    assert settings.address == settings.listen.address == "0.0.0.0"  # noqa: S104 - in a pod


def test_by_itself_the_console_answers_forwards_to_its_pod_alone(helm: Any, tmp_path: Path) -> None:
    """And the kubelet and Prometheus at the pod's address, by another port."""
    nobody: Any = {"signIn": {"issuer": "", "clientId": "", "url": "", "groups": []}}
    rendered = helm.template(CHARTS / "robotkube", PROFILES / "official.yaml", console=nobody)
    settings = read_settings(mounted(rendered, "console", tmp_path), console.read_configuration)
    assert (settings.by_forward, settings.sign_in) == (True, None)
    assert (settings.address, settings.listen.address) == ("127.0.0.1", "0.0.0.0")  # noqa: S104 - in a pod
    [port] = rendered.one("Service", "console")["spec"]["ports"]
    assert port["port"] == settings.listen.port


def test_forge_bootstrap_and_console_agree_on_signing_in_by_the_forge(helm: Any, tmp_path: Path) -> None:
    rendered = helm.template(
        CHARTS / "robotkube", *(PROFILES / f"{name}.yaml" for name in ("official", "forge-sign-in"))
    )
    settings = read_settings(mounted(rendered, "console", tmp_path / "console"), console.read_configuration)
    assert settings.sign_in is not None
    assert settings.sign_in.issuer == "https://forge.robotkube.svc.cluster.local:3000"
    assert f"ROOT_URL = {settings.sign_in.issuer}/" in rendered.one("Secret", "forge")["stringData"]["app.ini"]
    assert (settings.sign_in.pages, settings.sign_in.by_id_token) == ("https://forge.example", True)
    made = read_settings(mounted(rendered, "bootstrap", tmp_path / "bootstrap"), bootstrap.read_configuration).forge
    assert made is not None
    [client] = made.clients
    assert client.redirect == settings.sign_in.redirect
    written = rendered.one("ConfigMap", client.config_map)
    assert (client.namespace, "data" in written) == ("robotkube", False)
    pod = dict(rendered.pods)["Deployment/console"]
    [folder] = [one["mountPath"] for one in pod["containers"][0]["volumeMounts"] if one["name"] == "sign-in"]
    assert settings.client_id_file == Path(folder) / "client_id"
    assert {"name": "sign-in", "configMap": {"name": client.config_map}} in pod["volumes"]
    writing = {account.name for account in made.setup.accounts} & set(made.setup.repositories[0].access)
    assert settings.sign_in.groups == {"robotkube:deployment-write"}
    [team] = [one for one in plan_teams(made.setup) if f"{one.organisation}:{one.name}" in settings.sign_in.groups]
    assert team.members == {"operator-team", "reviewer", "gate"} <= writing


def test_the_values_of_the_how_to_of_signing_in_are_taken(helm: Any) -> None:
    page = (DOCS / "how-to" / "sign-in-at-the-console.md").read_text(encoding="utf-8")
    ingress, groups, forwarded = map(yaml.safe_load, re.findall(r"```yaml\n(.*?)```", page, re.DOTALL))
    given = yaml.safe_load((PROFILES / "official.yaml").read_text())
    del given["console"]
    rendered = [helm.template(CHARTS / "robotkube", helm.values(given), **one) for one in (ingress, forwarded)]
    settings = [yaml.safe_load(one.one("ConfigMap", "console")["data"]["config.yaml"]) for one in rendered]
    assert [setting["sign_in"]["pages"] for setting in settings] == [
        "https://git.example.com",
        "https://localhost:3000",
    ]
    assert [setting["sign_in"]["url"] for setting in settings] == [
        "https://console.example.com",
        "http://127.0.0.1:8080",
    ]
    both = {**ingress["console"], "signIn": {**ingress["console"]["signIn"], **groups["console"]["signIn"]}}
    rendered = helm.template(CHARTS / "robotkube", helm.values(given), console=both)
    settings = yaml.safe_load(rendered.one("ConfigMap", "console")["data"]["config.yaml"])["sign_in"]
    assert settings["groups"] == ["robotkube:deployment-write", "robotkube:deployment-pulls"]
    assert settings["writers"] == [{"group": "robotkube:deployment-write", "namespaces": ["cloud-0"]}]


def test_the_console_has_the_file_of_whom_it_believes_also_without_poses(helm: Any) -> None:
    """It signs in at a provider of that authority: at somebody else's broker it ended at its start."""
    authority = "-----BEGIN CERTIFICATE-----\nMIIB\n-----END CERTIFICATE-----\n"
    processes = dict.fromkeys(("gate", "manager", "suite-runner"), "theirs")
    secrets = {"database": "theirs", "forge": "theirs", "processes": processes}
    values: Any = {
        "broker": {"kind": "external", "external": {"host": "mqtt.example"}},
        "tls": {"mode": "provided", "provided": secrets, "authorities": authority},
    }
    rendered = helm.template(CHARTS / "robotkube", PROFILES / "official.yaml", **values)
    settings = yaml.safe_load(rendered.one("ConfigMap", "console")["data"]["config.yaml"])
    assert "poses" not in settings
    [container] = dict(rendered.pods)["Deployment/console"]["containers"]
    folder = settings["sign_in"]["authorities"].rpartition("/")[0]
    assert folder in {mount["mountPath"] for mount in container["volumeMounts"]}


def test_the_inspector_judges_the_gates_namespace_as_the_platforms(helm: Any, tmp_path: Path) -> None:
    rendered = helm.template(CHARTS / "robotkube", PROFILES / "official.yaml", gate={"namespace": "signing"})
    settings = read_settings(mounted(rendered, "inspector", tmp_path), inspector.read_configuration)
    assert settings.installation.domain.of_the_platform == ("robotkube", "signing")


def test_the_job_that_makes_the_key_reads_the_settings_the_chart_writes(official: Any, tmp_path: Path) -> None:
    settings = read_settings(mounted(official, "gate-key", tmp_path), gate_key.read_configuration)
    assert settings.namespaces == (settings.namespace, "robotkube") == ("robotkube-gate", "robotkube")


@pytest.mark.parametrize("profile", ["official", "embedded"])
@pytest.mark.parametrize("process", ["gate", "manager", "suite-runner"])
def test_probes_ask_the_port_for_health_and_services_the_other(
    request: pytest.FixtureRequest, tmp_path: Path, process: str, profile: str
) -> None:
    rendered = request.getfixturevalue(profile)
    listen = read_settings(mounted(rendered, process, tmp_path), PROCESSES[process].read_configuration).listen
    [container] = dict(rendered.pods)[f"Deployment/{process}"]["containers"]
    ports = {port["name"]: port["containerPort"] for port in container["ports"]}
    assert ports == {"https": listen.port, "health": listen.health_port}
    probes = [container[f"{kind}Probe"]["httpGet"] for kind in ("startup", "readiness", "liveness")]
    assert [probe["port"] for probe in probes] == ["health"] * 3
    [served] = rendered.one("Service", process, GATE if process == "gate" else None)["spec"]["ports"]
    assert (served["port"], served["targetPort"]) == (listen.port, "https")


def test_the_bootstrap_gets_all_seeds_and_accounts(official: Any, tmp_path: Path) -> None:
    settings = read_settings(mounted(official, "bootstrap", tmp_path), bootstrap.read_configuration)
    assert settings.forge is not None
    assert settings.database is not None
    deployment, catalogue = settings.forge.setup.repositories
    assert {".gitkeep" in path for path in deployment.seed} == {True, False}
    assert {"README.md", "policies/initial.yaml", "bootstrap/applicationset.yaml"} <= set(deployment.seed)
    assert read_release_policy(catalogue.seed["policies/release.yaml"].decode(), "release.yaml").assurance == "verified"
    verification = catalogue.seed["policies/verification.yaml"].decode()
    assert read_verification_policy(verification, "verification.yaml").suites
    initial = read_initial_policy(deployment.seed["policies/initial.yaml"].decode(), "initial.yaml")
    assert initial == InitialPolicy()
    assert [account.database for account in settings.database.accounts] == ["recordings_cloud_0"]


@pytest.mark.parametrize("profile", ["official", "embedded"])
def test_the_bootstrap_gives_the_rights_that_are_tried_on_a_forge(
    request: pytest.FixtureRequest, tmp_path: Path, profile: str
) -> None:
    path = mounted(request.getfixturevalue(profile), "bootstrap", tmp_path)
    settings = read_settings(path, bootstrap.read_configuration)
    assert settings.forge is not None
    assert {organisation.name: organisation.packages for organisation in settings.forge.setup.organisations} == PACKAGES
    viewers = {VIEWER: "pulls"} if profile == "embedded" else {}
    assert {account.name for account in settings.forge.setup.accounts} == set(ACCOUNTS) - {VIEWER} | set(viewers)
    for repository in settings.forge.setup.repositories:
        assert {name: level for name, level in repository.access.items() if level == "pulls"} == viewers


def test_each_webhook_has_a_secret_of_its_own_that_both_ends_know(helm: Any, tmp_path: Path) -> None:
    rendered = helm.template(CHARTS / "robotkube", PROFILES / "official.yaml", PROFILES / "managers.yaml")
    path = mounted(rendered, "gate", tmp_path / "gate")
    hearing = read_settings(path, gate.read_configuration)
    managers = {
        name: read_settings(mounted(rendered, name, tmp_path / name), manager.read_configuration)
        for name in ("manager", "manager-north")
    }
    own = {name: settings.webhook_secret for name, settings in managers.items()}
    assert hearing.proposer_secrets == own
    assert len({hearing.webhook_secret, *own.values()}) == 3
    for name, settings in managers.items():
        assert settings.gate_objects_url == f"{GATE_URL}{gate.OBJECTS_PATH}/{name}"
    making = read_settings(mounted(rendered, "bootstrap", tmp_path / "bootstrap"), bootstrap.read_configuration)
    assert making.forge is not None
    called = {(str(httpx.URL(hook.url).host).partition(".")[0], hook.secret) for hook in making.forge.setup.webhooks}
    listening = read_settings(mounted(rendered, "rights", tmp_path / "rights"), rights.read_configuration)
    assert called == {("gate", hearing.webhook_secret), ("rights", listening.webhook_secret), *own.items()}
    for shared in (own["manager"], hearing.webhook_secret):
        write(tmp_path / "gate/secrets/proposers/manager-north/secret", shared)
        with pytest.raises(InputError, match=r"forge.proposers\[1\].secret: the forge .* or another proposer has"):
            read_settings(path, gate.read_configuration)


@pytest.mark.parametrize("chart", APPS)
def test_robot_processes_read_the_settings_their_charts_write(apps: Mapping[str, Any], chart: str) -> None:
    text = apps[chart].one("ConfigMap", chart)["data"]["config.yaml"]
    assert APPS[chart](yaml.safe_load(text), chart)


def image_of(rendered: Any) -> str:
    """The image of the one pod of an application."""
    [(_, pod)] = rendered.pods
    return str(pod["containers"][0]["image"])


@pytest.mark.parametrize("chart", APPS)
def test_helm_renders_a_packed_chart_as_the_folder(
    helm: Any, apps: Mapping[str, Any], chart: str, tmp_path: Path
) -> None:
    images = {chart: image_of(apps[chart])}
    packed = pack(CHARTS / "apps" / chart, images)
    assert packed.digest == pack(CHARTS / "apps" / chart, images).digest
    archive = tmp_path / f"{chart}.tgz"
    archive.write_bytes(packed.archive)
    assert helm.template(archive, PROFILES / f"{chart}.yaml", release=chart).objects == apps[chart].objects


@pytest.mark.parametrize("chart", ["event-detector", "mqtt-bridge", "object-detection", "object-tracking"])
def test_an_earlier_version_is_packed_with_the_library_it_was_published_with(
    helm: Any, chart: str, tmp_path: Path
) -> None:
    own = PROFILES / "earlier" / f"{chart}.yaml"
    profile = own if own.exists() else PROFILES / f"{chart}.yaml"
    folder = helm.template(CHARTS / "earlier" / chart, profile, release=chart)
    archive = tmp_path / f"{chart}.tgz"
    archive.write_bytes(pack(CHARTS / "earlier" / chart, {"ros": image_of(folder)}).archive)
    assert helm.template(archive, profile, release=chart).objects == folder.objects
    assert "app.kubernetes.io/version" not in folder.one("Deployment", chart)["metadata"]["labels"]


@pytest.mark.parametrize("chart", ["event-detector", "mqtt-bridge"])
def test_values_and_settings_of_the_earlier_version_are_still_read(
    helm: Any, apps: Mapping[str, Any], chart: str, tmp_path: Path
) -> None:
    """Both versions run in one image, and values stay when a release is updated."""
    profile = PROFILES / "earlier" / f"{chart}.yaml"
    earlier = helm.template(CHARTS / "earlier" / chart, profile, release=chart)
    later = helm.template(CHARTS / "apps" / chart, profile, release=chart)
    older, newer = (
        APPS[chart](yaml.safe_load(rendering.one("ConfigMap", chart)["data"]["config.yaml"]), chart)
        for rendering in (earlier, later)
    )
    if chart == "mqtt-bridge":
        assert newer.publish_gaps, "the later one tells of gaps by itself"
        newer = replace(newer, publish_gaps=False)
    assert older == newer
    images = chart_images.all_as("x@sha256:" + "5" * 64)
    packed = [pack(CHARTS / folder / chart, images) for folder in ("apps", "earlier")]
    assert [one.version for one in packed] == ["0.2.3", "0.1.2"]


@pytest.mark.parametrize("chart", ["object-detection", "object-tracking"])
def test_two_versions_of_a_chart_differ_in_what_they_run(helm: Any, apps: Mapping[str, Any], chart: str) -> None:
    earlier = helm.template(CHARTS / "earlier" / chart, PROFILES / f"{chart}.yaml", release=chart)
    newer, older = (
        APPS[chart](yaml.safe_load(rendering.one("ConfigMap", chart)["data"]["config.yaml"]), chart)
        for rendering in (apps[chart], earlier)
    )
    assert newer != older
    images = chart_images.all_as("x@sha256:" + "5" * 64)
    packed = [pack(CHARTS / folder / chart, images) for folder in ("apps", "earlier")]
    assert [one.version for one in packed] == ["0.2.3", "0.1.2"]
    assert len({one.digest for one in packed}) == 2


def test_the_page_of_the_earlier_versions_names_one_that_is_there() -> None:
    names = re.findall(r"--chart (\S+)", (CHARTS / "earlier" / "README.md").read_text(encoding="utf-8"))
    metadata = (yaml.safe_load(file.read_text()) for file in (CHARTS / "earlier").glob("*/Chart.yaml"))
    assert names
    assert set(names) <= {f"{chart['name']}@{chart['version']}" for chart in metadata}
