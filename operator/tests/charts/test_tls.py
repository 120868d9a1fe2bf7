"""Who makes the broker's certificate: what the chart renders for each `tls.mode`, compared with a kept rendering for
cert-manager, which does not run here."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.delivery.certificates.settings import read_configuration
from robotkube.foundation.runtime.settings_file import read_settings
from tests.stages.paths import CHARTS
from tests.stages.settings_mounted import mounted

pytestmark = pytest.mark.toolchain

PLATFORM = CHARTS / "robotkube"
PROFILES = Path(__file__).parent / "profiles"
OFFICIAL = PROFILES / "official.yaml"
AUTHORITY = "-----BEGIN CERTIFICATE-----\nMIIB\n-----END CERTIFICATE-----\n"
AGENTS = ("vehicle-00", "vehicle-01", "cloud-0")
OURS = {"Deployment/certificates", "ConfigMap/certificates", "Role/certificates", "Secret/tls-authority"}


def names(rendered: Any) -> set[str]:
    return {f"{one['kind']}/{one['metadata']['name']}" for one in rendered.objects}


def ports(rendered: Any) -> list[int]:
    """Where the broker listens: the same in its settings, its pod and its Service."""
    text = rendered.one("ConfigMap", "broker")["data"]["mosquitto.conf"]
    found = [int(line.split()[1]) for line in text.splitlines() if line.startswith("listener ")]
    [container] = dict(rendered.pods)["Deployment/broker"]["containers"]
    assert [port["containerPort"] for port in container["ports"]] == found
    assert [port["port"] for port in rendered.one("Service", "broker")["spec"]["ports"]] == found
    assert {container[probe]["tcpSocket"]["port"] for probe in container if probe.endswith("Probe")} == {
        container["ports"][0]["name"]
    }
    return found


def accounts(rendered: Any) -> set[tuple[str, str]]:
    """Port and `tls` of everybody's account."""
    secrets = [one["stringData"] for one in rendered.of_kind("Secret") if "host" in one.get("stringData", {})]
    return {(secret["port"], secret["tls"]) for secret in secrets if secret["host"].startswith(("broker.", "mqtt."))}


def reached(rendered: Any) -> set[int]:
    """The ports at which policies let agents reach the broker."""
    policy = rendered.one("NetworkPolicy", "application", "vehicle-00")
    rules = [rule for rule in policy["spec"]["egress"] if "broker" in str(rule.get("to"))]
    return {port["port"] for rule in rules for port in rule["ports"]}


def trusted(rendered: Any) -> set[str]:
    """What stands in ConfigMap robotkube-ca of the platform and of every agent."""
    found = [rendered.one("ConfigMap", "robotkube-ca", place) for place in ("robotkube", *AGENTS)]
    return {one.get("data", {}).get("ca.crt", "") for one in found}


def test_by_itself_the_platform_makes_certificates_and_nobody_speaks_in_clear_text(official: Any) -> None:
    assert names(official) >= OURS
    assert (ports(official), accounts(official), reached(official)) == ([8883], {("8883", "required")}, {8883})
    assert trusted(official) == {""}
    assert "1883" not in official.one("ConfigMap", "broker")["data"]["mosquitto.conf"].replace("8883", "")
    assert "PRIVATE KEY" not in official.text
    for name in ("tls-authority", "broker-tls"):
        assert not {"data", "stringData"} & set(official.one("Secret", name))


def test_the_brokers_pod_waits_for_its_certificate_and_has_no_other_key(official: Any) -> None:
    pod = dict(official.pods)["Deployment/broker"]
    assert pod["automountServiceAccountToken"] is False
    assert "shareProcessNamespace" not in pod
    [volume] = [one for one in pod["volumes"] if one["name"] == "certificate"]
    assert volume["secret"]["secretName"] == "broker-tls"
    assert [item["key"] for item in volume["secret"]["items"]] == ["tls.crt", "tls.key"]
    mounting = {name for name, one in official.pods if "tls-authority" in str(one)}
    assert mounting == set()


def test_the_process_reads_the_settings_that_the_chart_writes(official: Any, tmp_path: Path) -> None:
    issuance = read_settings(mounted(official, "certificates", tmp_path), read_configuration).issuance
    assert (issuance.platform, issuance.namespaces) == ("robotkube", ("robotkube", *AGENTS))
    host = official.one("Secret", "broker-account", "vehicle-00")["stringData"]["host"]
    assert issuance.names[0] == host
    assert issuance.seconds == 90 * 86_400


def test_in_clear_text_as_well_where_a_value_asks_for_it(helm: Any) -> None:
    both = helm.template(PLATFORM, OFFICIAL, tls={"plain": True})
    assert (ports(both), accounts(both), reached(both)) == ([8883, 1883], {("8883", "required")}, {8883, 1883})


def test_off_is_clear_text_alone(helm: Any) -> None:
    off = helm.template(PLATFORM, OFFICIAL, tls={"mode": "off"})
    assert not names(off) & {*OURS, "Secret/broker-tls", "ConfigMap/robotkube-ca", "NetworkPolicy/certificates"}
    assert (ports(off), accounts(off), reached(off)) == ([1883], {("1883", "off")}, {1883})
    assert "authorities" not in off.one("ConfigMap", "manager")["data"]["config.yaml"]
    [container] = dict(off.pods)["Deployment/broker"]["containers"]
    assert container["command"] == ["mosquitto", "-c", "/etc/mosquitto/mosquitto.conf"]
    assert "/etc/robotkube/authorities" not in off.text


def test_a_provided_certificate_is_mounted_and_whoever_signed_it_told(helm: Any) -> None:
    provided = {"mode": "provided", "provided": {"secret": "mine"}, "authorities": AUTHORITY}
    rendered = helm.template(PLATFORM, OFFICIAL, tls=provided)
    assert not names(rendered) & {*OURS, "Secret/broker-tls", "Certificate/broker"}
    [volume] = [v for v in dict(rendered.pods)["Deployment/broker"]["volumes"] if v["name"] == "certificate"]
    assert volume["secret"]["secretName"] == "mine"
    assert (trusted(rendered), ports(rendered)) == ({AUTHORITY}, [8883])


def test_a_broker_of_somebody_else_is_verified_by_the_authorities_that_are_given(helm: Any) -> None:
    external = {"kind": "external", "external": {"host": "mqtt.example", "port": 8884}}
    rendered = helm.template(PLATFORM, OFFICIAL, broker=external, tls={"mode": "provided", "authorities": AUTHORITY})
    assert accounts(rendered) == {("8884", "required")}
    assert trusted(rendered) == {AUTHORITY}


def test_what_cert_manager_is_asked_for(helm: Any, golden: Callable[[str, str], None]) -> None:
    rendered = helm.template(PLATFORM, OFFICIAL, PROFILES / "cert-manager.yaml")
    assert not names(rendered) & OURS
    certificate = rendered.one("Certificate", "broker")
    [volume] = [v for v in dict(rendered.pods)["Deployment/broker"]["volumes"] if v["name"] == "certificate"]
    assert volume["secret"]["secretName"] == certificate["spec"]["secretName"]
    text = yaml.safe_dump_all([certificate, rendered.one("ConfigMap", "robotkube-ca", "vehicle-00")], sort_keys=False)
    golden("cert-manager", text)


def test_an_upgrade_that_reuses_values_of_before_has_certificates_made(helm: Any) -> None:
    values = yaml.safe_load((PLATFORM / "values.yaml").read_text(encoding="utf-8"))
    assert values["tls"]["mode"] == "made"
    rendered = helm.template(PLATFORM, OFFICIAL, tls=None, certificates=None)
    assert names(rendered) >= OURS


@pytest.mark.parametrize(
    ("place", "chart"), [("apps", "mqtt-bridge"), ("apps", "event-detector"), ("earlier", "mqtt-bridge")]
)
def test_charts_mount_the_account_and_whom_to_trust_into_one_folder(helm: Any, place: str, chart: str) -> None:
    profile = PROFILES / ("earlier" if place == "earlier" else "") / f"{chart}.yaml"
    rendered = helm.template(
        CHARTS / place / chart, profile, release=chart, broker={"existingSecret": "broker-account"}
    )
    [(_, pod)] = rendered.pods
    [volume] = [one for one in pod["volumes"] if one["name"] == "broker"]
    secret, authorities = volume["projected"]["sources"]
    assert secret == {"secret": {"name": "broker-account"}}
    assert authorities["configMap"]["optional"] is True
    assert authorities["configMap"]["items"] == [{"key": "ca.crt", "path": "ca.crt"}]
