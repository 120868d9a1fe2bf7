"""Secrets and ConfigMaps of certificates, read and written over an API server in memory."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from robotkube.delivery.certificates.adapters.certificate_objects import KubernetesCertificates
from robotkube.delivery.certificates.core.issuance import ServerCertificate
from robotkube.errors import InputError, UnavailableError
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
