"""How a run reaches broker and database from this machine: by their address, verified by the name that an account has,
wherever they stand. And the manager through the API server: by HTTPS where its Service says so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ci.cluster_contract.provider import ServicePort, directly
from robotkube.foundation.certificates.adapters.verification import ServerVerification
from scenarios.runner.platform.access import Access, Endpoint

HOST = "broker.robotkube.svc.cluster.local"
ACCOUNT = {"username": "observer", "password": "secret", "host": HOST, "port": "8883"}


class Cluster(Access):
    """The cluster's answers."""

    def __init__(self, tls: str, **others: str) -> None:
        self.values = {**ACCOUNT, **others, "tls": tls} if tls else {**ACCOUNT, **others}
        self._reach = directly

    def secret(self, namespace: str, name: str) -> dict[str, str]:
        assert (namespace, name) in [("robotkube", "broker-account-observer"), ("cloud-0", "database-account")]
        return dict(self.values)

    def configmap(self, namespace: str, name: str) -> dict[str, str]:
        assert (namespace, name, self.values["tls"]) == ("robotkube", "robotkube-ca", "required")
        return {"ca.crt": "the authority"}

    def service(self, name: str, namespace: str = "robotkube") -> tuple[ServicePort, bool]:
        addresses = {("robotkube", "broker"): "10.96.0.9", ("managed", "mqtt"): "10.96.0.10"}
        return ServicePort(namespace, name, addresses[namespace, name], 1), False


def test_the_broker_proves_the_name_of_its_service(tmp_path: Path) -> None:
    account = Cluster("required").broker_account("broker-account-observer", tmp_path)
    assert (account.host, account.port, account.username) == ("10.96.0.9", 8883, "observer")
    assert account.tls == ServerVerification(tmp_path / "ca.crt", HOST)
    assert (tmp_path / "ca.crt").read_text() == "the authority"
    assert tmp_path.stat().st_mode & 0o077 == 0


@pytest.mark.parametrize("tls", ["", "off"])
def test_in_clear_text_where_the_platform_says_so(tmp_path: Path, tls: str) -> None:
    account = Cluster(tls).broker_account("broker-account-observer", tmp_path)
    assert (account.host, account.tls) == ("10.96.0.9", None)


@pytest.mark.parametrize(
    ("host", "address"),
    [("mqtt.managed.svc.cluster.local", "10.96.0.10"), ("mqtt.example.com", "mqtt.example.com")],
)
def test_one_of_others_is_reached_where_its_account_says(tmp_path: Path, host: str, address: str) -> None:
    account = Cluster("required", host=host, port="8884").broker_account("broker-account-observer", tmp_path)
    assert (account.host, account.port) == (address, 8884)
    assert account.tls == ServerVerification(tmp_path / "ca.crt", host)


@pytest.mark.parametrize("host", ["mqtt.managed.svc", "mongo.example.com"])
def test_a_database_of_others_is_reached_in_the_same_way(tmp_path: Path, host: str) -> None:
    of_database = {"database": "recordings_cloud_0", "authenticationDatabase": "recordings_cloud_0"}
    login = Cluster("required", host=host, port="27017", **of_database).database_account("cloud-0", tmp_path)
    assert (login.host, login.port) == ("10.96.0.10" if host.endswith("svc") else host, 27017)
    assert login.tls == ServerVerification(tmp_path / "ca.crt", host)


class ClusterOfForge(Cluster):
    """The gate's settings, with one forge or another."""

    def __init__(self, url: str) -> None:
        super().__init__("off")
        self.url = url

    def configmap(self, namespace: str, name: str) -> dict[str, str]:
        assert (namespace, name) == ("robotkube-gate", "gate")
        return {"config.yaml": f"forge:\n  url: {self.url}\n"}


@pytest.mark.parametrize(
    ("url", "reached"),
    [
        ("http://mqtt.managed.svc.cluster.local:3000", Endpoint("10.96.0.10", 3000)),
        ("https://git.example.com", Endpoint("git.example.com", 443, encrypted=True)),
        ("https://git.example.com:8443", Endpoint("git.example.com", 8443, encrypted=True)),
    ],
)
def test_a_forge_of_others_is_where_the_gates_settings_say(url: str, reached: Endpoint) -> None:
    assert ClusterOfForge(url).forge() == reached


class ClusterOfManager(Access):
    """The cluster's answers: pages, by the path at the API server."""

    def __init__(self, encrypted: bool) -> None:
        self.encrypted = encrypted

    def endpoint(self, name: str, namespace: str = "robotkube") -> Endpoint:
        assert (name, namespace) == ("manager", "robotkube")
        return Endpoint("10.96.0.8", 8080, self.encrypted)

    def _proxied(self, path: str) -> Any:
        return path


@pytest.mark.parametrize(("encrypted", "service"), [(False, "manager:8080"), (True, "https:manager:8080")])
def test_the_manager_is_asked_as_its_service_says(encrypted: bool, service: str) -> None:
    asked = ClusterOfManager(encrypted).service_json("manager", "plans", 8080)
    assert asked == f"/api/v1/namespaces/robotkube/services/{service}/proxy/plans"
