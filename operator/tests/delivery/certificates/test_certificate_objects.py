"""Secrets and ConfigMaps of certificates, read and written over an API server in memory."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from robotkube.delivery.certificates.adapters.certificate_objects import MERGE, KubernetesCertificates
from robotkube.delivery.certificates.adapters.shut_accounts import ShutAccountsPage
from robotkube.delivery.certificates.core.issuance import AccountCertificate, AccountIssuance, ServerCertificate
from robotkube.delivery.certificates.core.register import IssuedCertificate, Register
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.adapters import issuing
from robotkube.foundation.certificates.core.lives import Pair
from tests.delivery.certificates.test_keeper import ISSUANCE

SECRETS = "/api/v1/namespaces/robotkube/secrets"
MAP = "/api/v1/namespaces/vehicle-00/configmaps/robotkube-ca"


class Api:
    """Objects by path; `conflict` answers writes."""

    def __init__(self) -> None:
        self.objects: dict[str, dict[str, Any]] = {
            path: {"metadata": {"resourceVersion": "7"}}
            for path in (f"{SECRETS}/tls-authority", f"{SECRETS}/broker-tls", MAP)
        }
        self.patches: list[tuple[str, Any, str]] = []
        self.conflict = False

    def request(
        self, method: str, path: str, body: Any = None, content_type: str = "application/json"
    ) -> tuple[int, dict[str, Any]]:
        if path not in self.objects:
            return 404, {}
        if method == "GET":
            return 200, self.objects[path]
        self.patches.append((path, body, content_type))
        return (409, {}) if self.conflict else (200, {})


def test_a_certificate_stands_where_it_is_mounted(api: Api) -> None:
    path = "/api/v1/namespaces/robotkube-gate/secrets/gate-tls"
    api.objects[path] = {"metadata": {}}
    gate = ServerCertificate("gate-tls", ("gate",), 60.0, namespace="robotkube-gate")
    objects = KubernetesCertificates(api, replace(ISSUANCE, certificates=(*ISSUANCE.certificates, gate)))
    assert objects.certificate("gate-tls") is None
    objects.put_certificate("gate-tls", Pair("c", "k"))
    assert objects.certificate("broker-tls") is None
    assert [patched for patched, _, _ in api.patches] == [path]


def data(**files: str) -> Mapping[str, Any]:
    return {name.replace("_", "."): base64.b64encode(text.encode()).decode() for name, text in files.items()}


@pytest.fixture
def api() -> Api:
    return Api()


@pytest.fixture
def objects(api: Api) -> KubernetesCertificates:
    return KubernetesCertificates(api, ISSUANCE)


def test_what_the_chart_made_is_empty(objects: KubernetesCertificates) -> None:
    assert (objects.authority(), objects.certificate("broker-tls"), objects.trusted("vehicle-00")) == (None, None, "")


def test_an_authority_is_kept_only_in_the_secret_that_was_read(api: Api, objects: KubernetesCertificates) -> None:
    objects.authority()
    objects.keep_authority(Pair("c", "k"))
    [(path, body, kind)] = api.patches
    assert (path, kind) == (f"{SECRETS}/tls-authority", "application/merge-patch+json")
    assert body == {"metadata": {"resourceVersion": "7"}, "stringData": {"tls.crt": "c", "tls.key": "k"}}
    api.conflict = True
    with pytest.raises(UnavailableError, match="somebody else changed it"):
        objects.keep_authority(Pair("c", "k"))


def test_half_an_authority_is_not_overwritten(api: Api, objects: KubernetesCertificates) -> None:
    api.objects[f"{SECRETS}/tls-authority"]["data"] = data(tls_crt="c")
    with pytest.raises(InputError, match=r"Secret tls-authority: tls.crt or tls.key is missing"):
        objects.authority()


def test_a_certificate_and_its_key_are_written_at_once(api: Api, objects: KubernetesCertificates) -> None:
    objects.put_certificate("broker-tls", Pair("c", "k"))
    assert api.patches[0][:2] == (f"{SECRETS}/broker-tls", {"stringData": {"tls.crt": "c", "tls.key": "k"}})
    api.objects[f"{SECRETS}/broker-tls"]["data"] = data(tls_crt="c", tls_key="k")
    assert objects.certificate("broker-tls") == Pair("c", "k")
    api.objects[f"{SECRETS}/broker-tls"]["data"] = {"tls.crt": "no base64", "tls.key": "a"}
    assert objects.certificate("broker-tls") is None


def test_a_namespace_is_told_the_public_part(api: Api, objects: KubernetesCertificates) -> None:
    objects.publish("vehicle-00", "c")
    assert api.patches[0][:2] == (MAP, {"data": {"ca.crt": "c"}})


def test_what_is_missing_is_named_with_the_way_back(api: Api, objects: KubernetesCertificates) -> None:
    del api.objects[MAP]
    with pytest.raises(InputError, match="ConfigMap vehicle-00/robotkube-ca is missing; the chart makes it"):
        objects.trusted("vehicle-00")
    with pytest.raises(InputError, match="ConfigMap vehicle-00/robotkube-ca is missing"):
        objects.publish("vehicle-00", "c")


@pytest.mark.parametrize(
    ("spec", "found"),
    [
        ({"clusterIP": "10.96.0.9", "clusterIPs": ["10.96.0.9", "fd00::9"]}, ["10.96.0.9", "fd00::9"]),
        ({"clusterIP": "10.96.0.9"}, ["10.96.0.9"]),
        ({"clusterIP": "None", "clusterIPs": ["None"]}, []),
        ({}, []),
    ],
)
def test_the_addresses_of_a_service_are_those_that_it_has(
    api: Api, objects: KubernetesCertificates, spec: Mapping[str, Any], found: list[str]
) -> None:
    api.objects["/api/v1/namespaces/robotkube/services/forge"] = {"spec": spec}
    assert objects.addresses("forge") == found


def test_a_service_that_is_missing_is_named(objects: KubernetesCertificates) -> None:
    with pytest.raises(InputError, match="Service forge is missing; the chart makes it"):
        objects.addresses("forge")


ACCOUNT = AccountCertificate("vehicle-00", "broker-account", "vehicle-00")
ACCOUNTS = AccountIssuance((ACCOUNT,), 60.0, "broker-certificates", "http://rights/accounts")
ACCOUNT_PATH = "/api/v1/namespaces/vehicle-00/secrets/broker-account"
REGISTER_PATH = "/api/v1/namespaces/robotkube/configmaps/broker-certificates"


@pytest.fixture
def of_accounts(api: Api) -> KubernetesCertificates:
    api.objects |= {path: {"metadata": {"resourceVersion": "9"}} for path in (ACCOUNT_PATH, REGISTER_PATH)}
    return KubernetesCertificates(api, replace(ISSUANCE, accounts=ACCOUNTS))


def test_an_accounts_certificate_stands_beside_its_password(api: Api, of_accounts: KubernetesCertificates) -> None:
    assert of_accounts.of_account(ACCOUNT) is None
    of_accounts.put_of_account(ACCOUNT, Pair("c", "k"))
    assert api.patches == [(ACCOUNT_PATH, {"stringData": {"tls.crt": "c", "tls.key": "k"}}, MERGE)]
    api.objects[ACCOUNT_PATH]["data"] = data(tls_crt="c", tls_key="k", username="vehicle-00")
    assert of_accounts.of_account(ACCOUNT) == Pair("c", "k")
    del api.objects[ACCOUNT_PATH]
    with pytest.raises(InputError, match="Secret vehicle-00/broker-account is missing"):
        of_accounts.of_account(ACCOUNT)


def test_the_register_is_replaced_only_as_it_was_read(api: Api, of_accounts: KubernetesCertificates) -> None:
    assert of_accounts.register() == (Register(), "")
    register = Register((IssuedCertificate("vehicle-00", 2**150, 60.0, revoked=30.0),))
    of_accounts.put_register(register, "list")
    [(path, body, _)] = api.patches
    assert (path, body["metadata"], body["data"]["revoked.crl"]) == (REGISTER_PATH, {"resourceVersion": "9"}, "list")
    api.objects[REGISTER_PATH]["data"] = body["data"]
    assert of_accounts.register() == (register, "list")
    api.conflict = True
    with pytest.raises(UnavailableError, match="ConfigMap robotkube/broker-certificates: somebody else changed it"):
        of_accounts.put_register(register, "list")
    api.objects[REGISTER_PATH]["data"] = {"register.json": "{"}
    with pytest.raises(InputError, match=r"ConfigMap robotkube/broker-certificates: register\.json cannot be read"):
        of_accounts.register()


def test_who_is_shut_is_read_from_a_page() -> None:
    pages = Pages({"commit": "c", "shut": ["vehicle-00"]})
    authority = issuing.new_authority("ours", 0.0, 60.0).certificate
    page = ShutAccountsPage(pages, "https://rights/accounts")
    assert page.shut(authority) == {"vehicle-00"}
    for answer in ({"shut": None}, {"shut": "vehicle-00"}, {"shut": [1]}, {}, InputError("no such page")):
        pages.answer = answer
        with pytest.raises(UnavailableError, match="https://rights/accounts: no"):
            page.shut(authority)


class Pages:
    """One page, or an error."""

    def __init__(self, answer: Any) -> None:
        self.answer = answer

    def get(self, url: str) -> Mapping[str, Any]:
        if isinstance(self.answer, Exception):
            raise self.answer
        return dict(self.answer)
