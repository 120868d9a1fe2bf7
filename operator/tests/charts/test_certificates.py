"""The process that keeps certificates, with the rights that the chart gives it, on a real API server: the authority is
made once and kept, the broker has its certificate, and every agent's namespace is told whom to trust."""

from __future__ import annotations

import base64
import os
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml

from robotkube.delivery.certificates.adapters.certificate_objects import KubernetesCertificates
from robotkube.delivery.certificates.core.issuance import Issuance
from robotkube.delivery.certificates.loops.account_keeper import AccountKeeper
from robotkube.delivery.certificates.loops.keeper import CertificateKeeper
from robotkube.delivery.certificates.settings import read_configuration
from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters import issuing
from robotkube.foundation.certificates.adapters.verification import ServerVerification
from robotkube.foundation.certificates.core.lives import Pair
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer
from tests.stages.handshakes import handshake, server_context
from tests.stages.kubernetes.installed_chart import CHART, Cluster, prepared_cluster
from tests.stages.programs import program
from tests.stages.secret_words import words

pytestmark = pytest.mark.toolchain

VALUES = ["-f", str(Path(__file__).parent / "profiles/official.yaml")]
ACCOUNT = "system:serviceaccount:robotkube:certificates"
AGENTS = ("vehicle-00", "vehicle-01", "cloud-0")
SERVERS = ("broker", "database", "forge", "gate", "manager", "rights", "suite-runner")


@dataclass
class Installed:
    """The platform on an API server without nodes; `api` is called as the account of the process."""

    cluster: Cluster
    administrator: httpx.Client
    api: ApiServer
    issuance: Issuance
    now: float = 0.0

    def keeper(self, issuance: Issuance | None = None) -> CertificateKeeper:
        """The process's loop after a start, on the adapters that it has."""
        issuance = issuance or self.issuance
        objects = KubernetesCertificates(self.api, issuance)
        return CertificateKeeper(objects, issuing, issuance, lambda: time.time() + self.now)

    def kept(self) -> None:
        keeper = self.keeper()
        keeper.step()
        assert keeper.reasons_not_ready() == []

    def read(self, namespace: str, kind: str, name: str) -> dict[str, str]:
        """The data of an object as the administrator reads it."""
        answer = self.administrator.get(f"/api/v1/namespaces/{namespace}/{kind}/{name}").raise_for_status().json()
        return dict(answer.get("data") or {})

    def decoded(self, namespace: str, name: str) -> dict[str, str]:
        """The values of a Secret."""
        read = self.read(namespace, "secrets", name)
        return {key: base64.b64decode(value).decode() for key, value in read.items()}

    def secret(self, name: str) -> dict[str, str]:
        return self.decoded(namespace_of(name), name)

    def trusted(self) -> set[str]:
        bundles = [self.read(place, "configmaps", "robotkube-ca") for place in ("robotkube", "robotkube-gate", *AGENTS)]
        return {bundle.get("ca.crt", "") for bundle in bundles}

    def empty(self) -> None:
        """As the chart made them."""
        for name in ("tls-authority", *(f"{server}-tls" for server in SERVERS)):
            merge = {"Content-Type": "application/merge-patch+json"}
            path = f"/api/v1/namespaces/{namespace_of(name)}/secrets/{name}"
            self.administrator.patch(path, content='{"data": null}', headers=merge)


def namespace_of(name: str) -> str:
    """Of the Secret with this name."""
    return "robotkube-gate" if name == "gate-tls" else "robotkube"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Installed]:
    with prepared_cluster(tmp_path_factory.mktemp("api")) as cluster:
        cluster.helm("install", "robotkube", str(CHART), *VALUES, "--no-hooks")
        environment = {**os.environ, "KUBECONFIG": str(cluster.kubeconfig), "HOME": str(cluster.kubeconfig.parent)}
        command = [program("kubectl"), "proxy", "--port=0", f"--as={ACCOUNT}"]
        proxy = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
        assert proxy.stdout is not None
        api = ApiServer("http://" + proxy.stdout.readline().split()[-1])
        with cluster.client() as administrator:
            answer = administrator.get("/api/v1/namespaces/robotkube/configmaps/certificates").json()
            document: Any = yaml.safe_load(answer["data"]["config.yaml"])
            issuance = read_configuration(Reader("config.yaml"), document).issuance
            yield Installed(cluster, administrator, api, issuance)
        api.close()
        proxy.kill()
        proxy.communicate(timeout=10)


@pytest.fixture
def stage(installed: Installed) -> Installed:
    installed.empty()
    installed.now = 0.0
    return installed


class Nobody:
    """Main, which shuts out nobody but an agent that has none."""

    names: frozenset[str] = frozenset()

    def shut(self, authority: str) -> frozenset[str]:
        return self.names


@dataclass
class Upgraded:
    """What was there in the course of four upgrades, of which each takes four seconds of a processor."""

    stage: Installed
    identities: list[tuple[str, set[str]]] = field(default_factory=list)  # how accounts are proved, after each
    keys_found: dict[str, list[str]] = field(default_factory=dict)  # of the Secret of a key, those in which it stands
    accounts: list[dict[str, str]] = field(default_factory=list)  # vehicle-00's: made, upgraded, shut out
    observer: dict[str, str] = field(default_factory=dict)
    authority: dict[str, str] = field(default_factory=dict)
    revoked: str = ""
    refusals: dict[str, str] = field(default_factory=dict)

    def upgrade(self, *options: str) -> None:
        self.stage.cluster.helm("upgrade", "robotkube", str(CHART), *VALUES, "--no-hooks", *options)
        self.look(" ".join(options))

    def look(self, after: str) -> None:
        accounts = [("robotkube", "broker-account-observer"), *((agent, "broker-account") for agent in AGENTS)]
        found = (self.stage.read(namespace, "secrets", name)["identity"] for namespace, name in accounts)
        self.identities.append((after, {base64.b64decode(one).decode() for one in found}))

    def refused(self, what: str, call: Callable[[], object]) -> None:
        with pytest.raises(InputError) as refusal:
            call()
        self.refusals[what] = str(refusal.value)

    def keep(self, keeper: CertificateKeeper) -> dict[str, str]:
        """Vehicle-00's account, after a step of the keeper."""
        keeper.step()
        assert keeper.reasons_not_ready() == []
        return self.stage.decoded("vehicle-00", "broker-account")

    def find_keys(self) -> None:
        items = self.stage.administrator.get("/api/v1/secrets").raise_for_status().json()["items"]
        said = {item["metadata"]["name"]: words(item) for item in items}
        for name in ("tls-authority", *(f"{server}-tls" for server in SERVERS)):
            body = self.stage.secret(name)["tls.key"].splitlines()[1]
            self.keys_found[name] = [found for found, text in said.items() if body in text]


@pytest.fixture(scope="module")
def upgraded(installed: Installed) -> Upgraded:
    """From certificates to passwords, which stay, and back to certificates, which stay."""
    seen = Upgraded(installed)
    installed.empty()
    seen.look("installed")
    seen.upgrade("--set", "tls.accounts=passwords")
    issuance = installed.issuance
    assert issuance.accounts is not None
    main = Nobody()
    objects = KubernetesCertificates(installed.api, issuance)
    with_passwords = issuance.accounts.certificates[-1]
    seen.refused("accounts that have passwords", lambda: objects.of_account(with_passwords))
    seen.upgrade()
    seen.upgrade("--set", "tls.accounts=certificates")
    accounts = AccountKeeper(objects, issuing, issuance.accounts, main, time.time)
    keeper = CertificateKeeper(objects, issuing, issuance, time.time, accounts)
    seen.accounts.append(seen.keep(keeper))
    seen.upgrade("--set", "logLevel=debug")
    seen.find_keys()
    seen.accounts.append(seen.keep(keeper))
    main.names = frozenset({"vehicle-00"})
    seen.accounts.append(seen.keep(keeper))
    seen.observer = installed.decoded("robotkube", "broker-account-observer")
    seen.authority = installed.secret("tls-authority")
    seen.revoked = installed.read("robotkube", "configmaps", "broker-certificates")["revoked.crl"]
    for path in ("cloud-0/secrets/database-account", "robotkube/secrets/robotkube-seed"):
        seen.refused(path, lambda path=path: installed.api.get(f"/api/v1/namespaces/{path}"))
    return seen


@pytest.mark.parametrize("name", SERVERS)
def test_each_server_has_a_certificate_that_every_agent_verifies(stage: Installed, tmp_path: Path, name: str) -> None:
    stage.kept()
    [authority] = stage.trusted()
    assert authority == stage.secret("tls-authority")["tls.crt"]
    (tmp_path / "ca.crt").write_text(authority)
    shown = stage.secret(f"{name}-tls")
    server = server_context(tmp_path / "server", Pair(shown["tls.crt"], shown["tls.key"]))
    host = f"{name}.{namespace_of(f'{name}-tls')}.svc.cluster.local"
    assert handshake(server, ServerVerification(tmp_path / "ca.crt", host)) == "TLSv1.3"
    assert not any("PRIVATE" in text for text in stage.trusted())


@pytest.mark.thorough
def test_upgrades_and_restarts_keep_both_and_a_renewal_the_authority(stage: Installed) -> None:
    stage.kept()
    authority, shown = stage.secret("tls-authority"), stage.secret("broker-tls")
    for options in ((), ("--set", "logLevel=debug")):
        stage.cluster.helm("upgrade", "robotkube", str(CHART), *VALUES, "--no-hooks", *options)
        stage.kept()
        assert (stage.secret("tls-authority"), stage.secret("broker-tls")) == (authority, shown)
        assert stage.trusted() == {authority["tls.crt"]}
    stage.now = 2 / 3 * stage.issuance.certificates[0].seconds
    stage.kept()
    assert stage.secret("broker-tls") != shown
    assert stage.secret("tls-authority") == authority


@pytest.mark.thorough
def test_processes_change_to_http_and_back_by_upgrades(stage: Installed) -> None:
    """The API server takes both, and the gate has the certificate again that it had."""
    stage.kept()
    shown = stage.secret("gate-tls")
    for options, name in ((("--set", "tls.processes=false"), "http"), ((), "https")):
        stage.cluster.helm("upgrade", "robotkube", str(CHART), *VALUES, "--no-hooks", *options)
        service = stage.administrator.get("/api/v1/namespaces/robotkube-gate/services/gate").raise_for_status().json()
        assert [(port["name"], port["port"]) for port in service["spec"]["ports"]] == [(name, 8080)]
        assert stage.secret("gate-tls") == shown
    stage.kept()


def test_no_key_stands_in_a_release_of_helms_or_in_another_secret(upgraded: Upgraded) -> None:
    assert sorted(upgraded.keys_found) == sorted(("tls-authority", *(f"{server}-tls" for server in SERVERS)))
    for name, found in upgraded.keys_found.items():
        assert found == [name]


def test_what_another_hand_wrote_into_an_agents_namespace_is_put_right(stage: Installed) -> None:
    stage.kept()
    before = stage.trusted()
    path = "/api/v1/namespaces/vehicle-00/configmaps/robotkube-ca"
    merge = {"Content-Type": "application/merge-patch+json"}
    stage.administrator.patch(path, content='{"data": {"ca.crt": "another"}}', headers=merge).raise_for_status()
    stage.kept()
    assert stage.trusted() == before


def test_the_authority_is_written_only_into_the_secret_that_was_read_empty(stage: Installed) -> None:
    """Two processes at once, as during an upgrade: the second one takes the first one's."""
    slow = KubernetesCertificates(stage.api, stage.issuance)
    assert slow.authority() is None
    stage.kept()
    kept = stage.secret("tls-authority")
    with pytest.raises(Exception, match="somebody else changed it at the same time"):
        slow.keep_authority(issuing.new_authority("slow", time.time()))
    assert stage.secret("tls-authority") == kept


def test_a_platform_that_has_passwords_keeps_them_until_somebody_says_otherwise(upgraded: Upgraded) -> None:
    """Robots whose images are of before know nothing of certificates. The first installation had them at once."""
    assert upgraded.identities == [
        ("installed", {"certificate"}),
        ("--set tls.accounts=passwords", {"password"}),
        ("", {"password"}),
        ("--set tls.accounts=certificates", {"certificate"}),
        ("--set logLevel=debug", {"certificate"}),
    ]


def test_accounts_at_the_broker_have_certificates_that_helm_leaves_alone(upgraded: Upgraded) -> None:
    """By the rights that the chart gives with certificates: those of each account, and a list of the
    revoked ones. With passwords it gives none."""
    before, after, shut = upgraded.accounts
    assert {"username", "password", "identity", "tls", "tls.crt", "tls.key"} <= set(before)
    assert "tls.key" in upgraded.observer
    assert after == shut == before
    authority = Pair(upgraded.authority["tls.crt"], upgraded.authority["tls.key"])
    shown = Pair(before["tls.crt"], before["tls.key"])
    assert issuing.listed(upgraded.revoked, authority) == {issuing.describe(shown, authority).serial}
    assert len(upgraded.refusals) == 3
    for what, refusal in upgraded.refusals.items():
        assert "is forbidden" in refusal, what


@pytest.mark.parametrize("secret", ["robotkube-seed", "broker-accounts", "forge-account-gate"])
def test_other_secrets_are_refused_and_none_can_be_made(stage: Installed, secret: str) -> None:
    keeper = stage.keeper(replace(stage.issuance, authority=secret))
    keeper.step()
    assert f'secrets "{secret}" is forbidden' in keeper.problem
    token = {"type": "kubernetes.io/service-account-token", "metadata": {"name": "mine"}}
    with pytest.raises(InputError, match="secrets is forbidden"):
        stage.api.create("/api/v1/namespaces/robotkube/secrets", {"apiVersion": "v1", "kind": "Secret", **token})
    with pytest.raises(InputError, match='secrets "broker-tls" is forbidden'):
        stage.api.delete("/api/v1/namespaces/robotkube/secrets/broker-tls")
