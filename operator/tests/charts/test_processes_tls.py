"""The platform's own processes by HTTPS, as the chart renders them for each `tls.mode`: who serves has a certificate
for the name by which he is asked, and who asks knows who may have signed it."""

from __future__ import annotations

import ssl
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
import yaml

from robotkube.delivery.certificates.settings import read_configuration as read_certificates
from robotkube.delivery.console.settings import read_configuration as read_console
from robotkube.delivery.gate import __main__ as gate
from robotkube.delivery.manager import __main__ as manager
from robotkube.delivery.rights import __main__ as rights
from robotkube.delivery.rights.settings import read_configuration as read_rights
from robotkube.foundation.certificates.adapters.issuing import new_authority
from robotkube.foundation.runtime.adapters.webhook_server import WebServer
from robotkube.foundation.runtime.settings_file import read_settings
from robotkube.registry.admission import __main__ as admission
from robotkube.registry.suites import __main__ as suites
from robotkube.registry.suites.settings import read_configuration as read_suite_runner
from robotkube.setup.bootstrap import read_configuration as read_bootstrap
from tests.stages import http_calls
from tests.stages.handshakes import certified
from tests.stages.paths import CHARTS
from tests.stages.settings_mounted import mounted

pytestmark = pytest.mark.toolchain

PLATFORM = CHARTS / "robotkube"
PROFILES = Path(__file__).parent / "profiles"
OFFICIAL = PROFILES / "official.yaml"
AUTHORITY = "-----BEGIN CERTIFICATE-----\nMIIB\n-----END CERTIFICATE-----\n"
SERVING = {
    "gate": gate.read_configuration,
    "manager": manager.read_configuration,
    "manager-north": manager.read_configuration,
    "rights": read_rights,
    "admission": admission.read_configuration,
    "suite-runner": read_suite_runner,
}
GIVEN = {name: f"{name}-given" for name in SERVING}
PROVIDED: dict[str, Any] = {
    "mode": "provided",
    "provided": {"secret": "its", "database": "its", "forge": "its", "processes": GIVEN},
    "authorities": AUTHORITY,
}
MODES: dict[str, dict[str, Any]] = {
    "made": {},
    "provided": {"tls": PROVIDED},
    "cert-manager": {"tls": yaml.safe_load((PROFILES / "cert-manager.yaml").read_text(encoding="utf-8"))["tls"]},
}
ASKING = (
    "Deployment/gate",
    "Deployment/manager",
    "Deployment/manager-north",
    "Deployment/console",
    "StatefulSet/forge",
)
AUTHORITIES = "/etc/robotkube/authorities"


def namespace_of(process: str) -> str | None:
    return "robotkube-gate" if process == "gate" else None


@pytest.fixture(params=MODES)
def mode(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def encrypted(helm: Any, mode: str) -> Any:
    """Two managers, and all that can serve."""
    return rendered(helm, **MODES[mode])


def rendered(helm: Any, *profiles: Path, **values: Any) -> Any:
    more = (PROFILES / "managers.yaml", PROFILES / "admission.yaml")
    return helm.template(PLATFORM, OFFICIAL, *more, *profiles, **values)


def settings(rendered: Any, process: str) -> Any:
    return yaml.safe_load(rendered.one("ConfigMap", process, namespace_of(process))["data"]["config.yaml"])


def asked(rendered: Any) -> Iterator[str]:
    """Every address by which a process is asked."""
    gate = settings(rendered, "gate")
    yield gate["suites"]["url"]
    yield from (one["webhook"] for one in gate["forge"]["proposers"])
    yield from (settings(rendered, name)["gate"]["objects"] for name in ("manager", "manager-north"))
    yield from (one["url"] for one in settings(rendered, "console")["managers"])
    yield from (one["url"] for one in settings(rendered, "bootstrap")["forge"]["webhooks"])


def port_names(rendered: Any, process: str) -> set[str]:
    """Of the Service, what that leads to in the pod, and what is open there; its probes ask the other port."""
    [port] = rendered.one("Service", process, namespace_of(process))["spec"]["ports"]
    [container] = dict(rendered.pods)[f"Deployment/{process}"]["containers"]
    [opened] = [one["name"] for one in container["ports"] if one["containerPort"] == port["port"]]
    probes = {container[probe]["httpGet"]["port"] for probe in container if probe.endswith("Probe")}
    assert probes == {"health"}
    return {port["name"], port["targetPort"], opened}


def certificate_of(rendered: Any, process: str) -> str | None:
    """The Secret with its certificate, mounted where its settings say, without which the pod waits; None without."""
    folder = settings(rendered, process)["listen"].get("certificate")
    sources = [
        source["secret"]
        for volume in dict(rendered.pods)[f"Deployment/{process}"]["volumes"]
        for source in volume.get("projected", {}).get("sources", [])
        if "secret" in source and "certificate/tls.key" in str(source["secret"]["items"])
    ]
    assert len(sources) == (folder is not None)
    if folder is None:
        return None
    assert folder == "/var/run/secrets/robotkube/certificate"
    [source] = sources
    assert {item["path"] for item in source["items"]} == {"certificate/tls.crt", "certificate/tls.key"}
    assert not source.get("optional")
    return str(source["name"])


def mounts(rendered: Any, workload: str) -> set[str]:
    pod = dict(rendered.pods)[workload]
    [container] = pod["containers"]
    paths = {one["name"]: one["mountPath"] for one in container["volumeMounts"]}
    assert paths.keys() <= {one["name"] for one in pod["volumes"]}
    return set(paths.values())


def test_everybody_is_asked_by_https_and_has_a_certificate_for_that_name(encrypted: Any, mode: str) -> None:
    urls = [urlsplit(url) for url in asked(encrypted)]
    assert {url.scheme for url in urls} == {"https"}
    assert {str(url.hostname).partition(".")[0] for url in urls} == set(SERVING)
    for process in SERVING:
        assert port_names(encrypted, process) == {"https"}
        name = GIVEN[process] if mode == "provided" else f"{process}-tls"
        assert certificate_of(encrypted, process) == name
    if mode != "provided":
        certified = {name for names in certificates(encrypted, mode).values() for name in names}
        assert {str(url.hostname) for url in urls} <= certified


def certificates(rendered: Any, mode: str) -> Mapping[str, list[str]]:
    """The names in each certificate, by the namespace and the name of its Secret."""
    if mode == "cert-manager":
        return {
            f"{one['metadata'].get('namespace', 'robotkube')}/{one['spec']['secretName']}": one["spec"]["dnsNames"]
            for one in rendered.of_kind("Certificate")
        }
    return {
        f"{one.get('namespace', 'robotkube')}/{one['secret']}": one["names"]
        for one in settings(rendered, "certificates")["certificates"]
    }


def test_a_certificate_is_made_where_it_is_mounted(encrypted: Any, mode: str) -> None:
    if mode == "provided":
        assert not [one for one in encrypted.of_kind("Secret", "Certificate") if one["metadata"]["name"] == "gate-tls"]
        return
    made = certificates(encrypted, mode)
    assert made["robotkube-gate/gate-tls"][0] == "gate.robotkube-gate.svc.cluster.local"
    for process in SERVING.keys() - {"gate"}:
        assert made[f"robotkube/{process}-tls"][0] == f"{process}.robotkube.svc.cluster.local"
    if mode == "made":
        for process in SERVING:
            assert "data" not in encrypted.one("Secret", f"{process}-tls", namespace_of(process))


def test_who_asks_knows_who_may_have_signed(encrypted: Any, mode: str) -> None:
    for process in ("gate", "manager", "manager-north", "console"):
        assert settings(encrypted, process)["authorities"] == f"{AUTHORITIES}/ca.crt"
    for workload in ASKING:
        assert AUTHORITIES in mounts(encrypted, workload), workload
    authorities = encrypted.one("ConfigMap", "robotkube-ca", "robotkube-gate")
    assert authorities.get("data", {}) == (
        {} if mode == "made" else {"ca.crt": authorities.get("data", {}).get("ca.crt")}
    )
    [container] = dict(encrypted.pods)["StatefulSet/forge"]["containers"]
    assert {"name": "SSL_CERT_DIR", "value": AUTHORITIES} in container["env"]


def test_the_processes_read_what_the_chart_writes(encrypted: Any, tmp_path: Path) -> None:
    for process, read in SERVING.items():
        configuration: Any = read_settings(mounted(encrypted, process, tmp_path / process), read)
        assert configuration.listen.certificate == tmp_path / process / "secrets" / "certificate"
        assert (configuration.listen.certificate / "tls.key").is_file()
    north = read_settings(mounted(encrypted, "manager-north", tmp_path / "north"), manager.read_configuration)
    assert north.server_name == "manager-north.robotkube.svc.cluster.local"
    assert north.authorities == tmp_path / "north" / "authorities" / "ca.crt"
    console = read_settings(mounted(encrypted, "console", tmp_path / "console"), read_console)
    assert console.authorities[0] == tmp_path / "console" / "authorities" / "ca.crt"


class UnaskedParts:
    """The parts of any process whose methods its server names; whether it lives is answered without calling one."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.records = self.statistics = self

    def reasons_not_ready(self) -> list[str]:
        return self._called("reasons_not_ready")

    def metrics(self) -> list[str]:
        return self._called("metrics")

    def put(self, *_: Any) -> list[str]:
        return self._called("put")

    def as_json(self) -> list[str]:
        return self._called("as_json")

    def catalogue_page(self) -> list[str]:
        return self._called("catalogue_page")

    def updates_page(self) -> list[str]:
        return self._called("updates_page")

    def what_if(self, *_: Any) -> list[str]:
        return self._called("what_if")

    def _called(self, name: str) -> list[str]:
        self.calls.append(name)
        return []


def server_of(process: str, configuration: Any, folder: Path, parts: Any) -> WebServer:
    """The server of a process on such parts."""
    if process == "gate":
        return gate.build_server(configuration, parts, parts, parts)
    if process == "manager":
        return manager.build_server(configuration, parts, parts, None, parts, parts)
    if process == "suite-runner":
        return suites.build_server(configuration, parts)
    if process == "rights":
        return rights.RightsProcess(configuration, parts).server
    return admission.AdmissionWriter(configuration, parts, folder / "work").server


@pytest.mark.parametrize("process", sorted(SERVING.keys() - {"manager-north"}))
def test_each_process_serves_with_what_the_chart_mounts(helm: Any, tmp_path: Path, process: str) -> None:
    path = mounted(rendered(helm), process, tmp_path)
    authority = new_authority("ours", time.time())
    certified(tmp_path / "secrets" / "certificate", authority, "localhost")
    settings: Any = read_settings(path, SERVING[process])
    listen = replace(settings.listen, address="127.0.0.1", port=0, health_port=0)
    parts = UnaskedParts()
    server = server_of(process, replace(settings, listen=listen), tmp_path, parts)
    server.start()
    believing = ssl.create_default_context(cadata=authority.certificate)
    try:
        assert httpx.get(f"https://localhost:{server.port}/livez", verify=believing).status_code == 200
        assert http_calls.get(f"http://localhost:{server.ports['health_port']}/livez").status_code == 200
    finally:
        server.stop()
    assert not parts.calls


def test_the_forge_of_http_and_one_of_somebody_else_leave_them_by_https(helm: Any) -> None:
    plain = rendered(helm, forge={"tls": False})
    assert {urlsplit(url).scheme for url in asked(plain)} == {"https"}
    assert "authorities" not in settings(plain, "gate")["forge"]
    for workload in ASKING:
        assert AUTHORITIES in mounts(plain, workload), workload
    [container] = dict(plain.pods)["StatefulSet/forge"]["containers"]
    assert {"name": "SSL_CERT_DIR", "value": AUTHORITIES} in container["env"]
    external = {"kind": "external", "tls": False, "external": {"url": "https://git.example"}}
    elsewhere = rendered(helm, forge=external)
    assert settings(elsewhere, "gate")["authorities"] == f"{AUTHORITIES}/ca.crt"
    assert AUTHORITIES in mounts(elsewhere, "Deployment/gate")


@pytest.mark.parametrize("values", [{"processes": False}, {"mode": "off"}], ids=["processes", "mode"])
def test_in_clear_text_nothing_is_different(helm: Any, values: dict[str, Any]) -> None:
    plain = rendered(helm, tls=values)
    assert {urlsplit(url).scheme for url in asked(plain)} == {"http"}
    for process in SERVING:
        assert (port_names(plain, process), certificate_of(plain, process)) == ({"http"}, None)
    for process in ("gate", "manager", "console"):
        assert "authorities" not in settings(plain, process)
    assert "server_name" not in settings(plain, "manager")["lease"]
    assert not [
        one for one in plain.of_kind("Secret") if one["metadata"]["name"] in {f"{name}-tls" for name in SERVING}
    ]


@pytest.mark.parametrize(("on", "former"), [(True, "http"), (False, "https")])
def test_webhooks_that_would_speak_otherwise_are_taken_away(helm: Any, tmp_path: Path, on: bool, former: str) -> None:
    """Of before the value changed: the forge would go on calling them in vain."""
    configuration = read_settings(mounted(rendered(helm, tls={"processes": on}), "bootstrap", tmp_path), read_bootstrap)
    assert configuration.forge is not None
    today = {(webhook.repository, webhook.url) for webhook in configuration.forge.setup.webhooks}
    gone = {(webhook.repository, webhook.url) for webhook in configuration.forge.setup.former_webhooks}
    assert not today & gone
    assert {(repository, url.replace("https:", "http:")) for repository, url in today} <= {
        (repository, url.replace("https:", "http:")) for repository, url in gone if url.startswith(f"{former}:")
    }


def test_the_process_that_keeps_certificates_may_write_the_gates_and_nothing_else_there(helm: Any) -> None:
    rendering = rendered(helm)
    rules = rendering.one("Role", "certificates", "robotkube-gate")["rules"]
    assert [(rule["resources"], rule["resourceNames"], rule["verbs"]) for rule in rules] == [
        (["configmaps"], ["robotkube-ca"], ["get", "patch"]),
        (["secrets"], ["gate-tls"], ["get", "patch"]),
    ]
    [secrets] = [
        rule["resourceNames"]
        for rule in rendering.one("Role", "certificates", "robotkube")["rules"]
        if rule["resources"] == ["secrets"]
    ]
    named = {"tls-authority", "broker-tls", "database-tls", "forge-tls", *(f"{name}-tls" for name in SERVING)}
    assert {secret for secret in secrets if not secret.startswith("broker-account-")} == named - {"gate-tls"}


def test_no_pod_mounts_the_key_of_another(helm: Any) -> None:
    rendering = rendered(helm)
    for process in SERVING:
        mounting = {name for name, pod in rendering.pods if f"'{process}-tls'" in str(pod["volumes"])}
        assert mounting == {f"Deployment/{process}"}


def test_the_process_reads_for_whom_to_make_certificates(helm: Any, tmp_path: Path) -> None:
    issuance = read_settings(mounted(rendered(helm), "certificates", tmp_path), read_certificates).issuance
    named = {certificate.secret: certificate for certificate in issuance.certificates}
    assert named["gate-tls"].namespace == "robotkube-gate"
    assert named["manager-north-tls"].namespace == ""
    assert "robotkube-gate" in issuance.namespaces


def test_an_upgrade_that_reuses_values_of_before_leaves_them_as_they_are(helm: Any) -> None:
    reused = rendered(helm, tls=None)
    assert {urlsplit(url).scheme for url in asked(reused)} == {"http"}
