"""The port CertificateObjects through the API server: Secrets by name in the platform's namespace or that of who mounts
them, and a ConfigMap by name in each namespace. The chart makes them, empty; this fills them, and needs no right to
make any."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Mapping, Sequence
from typing import Any, Protocol
from urllib.parse import quote

from robotkube.delivery.certificates.core import register as registers
from robotkube.delivery.certificates.core.issuance import AccountCertificate, Issuance
from robotkube.delivery.certificates.core.register import Register
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.core.lives import Pair
from robotkube.foundation.kubernetes.adapters.http_client import config_map_path

CERTIFICATE, KEY, AUTHORITY = "tls.crt", "tls.key", "ca.crt"
REGISTER, REVOKED = "register.json", "revoked.crl"
MERGE = "application/merge-patch+json"
CONFLICT, MISSING = 409, 404
NO_ADDRESS = (None, "", "None")  # the last one: of a headless Service


class RequestingApi(Protocol):
    """The call needed of an API server; `foundation.kubernetes.adapters.http_client.ApiServer` offers it."""

    def request(self, method: str, path: str, body: Any = None, content_type: str = ...) -> tuple[int, dict[str, Any]]:
        """Status and document of a request."""
        ...


class KubernetesCertificates:
    """The objects that `issuance` names."""

    def __init__(self, api: RequestingApi, issuance: Issuance) -> None:
        self._api = api
        self._issuance = issuance
        self._namespaces = {
            certificate.secret: certificate.namespace for certificate in issuance.certificates if certificate.namespace
        }
        self._version = self._register_version = ""

    def authority(self) -> Pair | None:
        """See the port."""
        name = self._issuance.authority
        document = self._read(self._secret(name), f"Secret {name}")
        self._version = str(document["metadata"].get("resourceVersion", ""))
        data = document.get("data") or {}
        if not data.get(CERTIFICATE) and not data.get(KEY):
            return None
        pair = _pair(data)
        if pair is None:
            raise InputError(
                f"Secret {name}: {CERTIFICATE} or {KEY} is missing or cannot be read; bring it back, or empty the "
                "Secret: then another authority is made, and everybody has to trust that"
            )
        return pair

    def keep_authority(self, authority: Pair) -> None:
        """See the port."""
        body = {"metadata": {"resourceVersion": self._version}, "stringData": _files(authority)}
        self._patch(self._secret(self._issuance.authority), f"Secret {self._issuance.authority}", body)

    def certificate(self, secret: str) -> Pair | None:
        """See the port."""
        return _pair(self._read(self._secret(secret), f"Secret {secret}").get("data") or {})

    def put_certificate(self, secret: str, certificate: Pair) -> None:
        """See the port."""
        self._patch(self._secret(secret), f"Secret {secret}", {"stringData": _files(certificate)})

    def of_account(self, account: AccountCertificate) -> Pair | None:
        """See the port."""
        document = self._read(_secret_path(account.namespace, account.secret), _about_account(account))
        return _pair(document.get("data") or {})

    def put_of_account(self, account: AccountCertificate, certificate: Pair) -> None:
        """See the port."""
        path = _secret_path(account.namespace, account.secret)
        self._patch(path, _about_account(account), {"stringData": _files(certificate)})

    def register(self) -> tuple[Register, str]:
        """See the port."""
        document = self._read(self._register_path(), self._about_register())
        self._register_version = str(document["metadata"].get("resourceVersion", ""))
        data = document.get("data") or {}
        try:
            return registers.read(data.get(REGISTER, "")), data.get(REVOKED, "")
        except InputError as error:
            raise InputError(f"{self._about_register()}: {error}") from error

    def put_register(self, register: Register, revocations: str) -> None:
        """See the port."""
        data = {REGISTER: registers.written(register), REVOKED: revocations}
        body = {"metadata": {"resourceVersion": self._register_version}, "data": data}
        self._patch(self._register_path(), self._about_register(), body)

    def addresses(self, service: str) -> Sequence[str]:
        """See the port."""
        path = f"/api/v1/namespaces/{quote(self._issuance.platform)}/services/{quote(service)}"
        spec = self._read(path, f"Service {service}").get("spec") or {}
        return [address for address in spec.get("clusterIPs") or [spec.get("clusterIP")] if address not in NO_ADDRESS]

    def trusted(self, namespace: str) -> str:
        """See the port."""
        data = self._read(self._config_map(namespace), self._about(namespace)).get("data") or {}
        return str(data.get(AUTHORITY, ""))

    def publish(self, namespace: str, certificate: str) -> None:
        """See the port."""
        self._patch(self._config_map(namespace), self._about(namespace), {"data": {AUTHORITY: certificate}})

    def _secret(self, name: str) -> str:
        return _secret_path(self._namespaces.get(name, self._issuance.platform), name)

    def _register_path(self) -> str:
        assert self._issuance.accounts is not None
        return config_map_path(self._issuance.platform, self._issuance.accounts.register)

    def _about_register(self) -> str:
        assert self._issuance.accounts is not None
        return f"ConfigMap {self._issuance.platform}/{self._issuance.accounts.register}"

    def _config_map(self, namespace: str) -> str:
        return config_map_path(namespace, self._issuance.trusted)

    def _about(self, namespace: str) -> str:
        return f"ConfigMap {namespace}/{self._issuance.trusted}"

    def _read(self, path: str, about: str) -> Mapping[str, Any]:
        status, document = self._api.request("GET", path)
        return document if status != MISSING else _missing(about)

    def _patch(self, path: str, about: str, body: Mapping[str, Any]) -> None:
        status, _ = self._api.request("PATCH", path, body, MERGE)
        if status == MISSING:
            _missing(about)
        if status == CONFLICT:
            raise UnavailableError(f"{about}: somebody else changed it at the same time; it is looked at again")


def _secret_path(namespace: str, name: str) -> str:
    return f"/api/v1/namespaces/{quote(namespace)}/secrets/{quote(name)}"


def _about_account(account: AccountCertificate) -> str:
    return f"Secret {account.namespace}/{account.secret}"


def _missing(about: str) -> Mapping[str, Any]:
    raise InputError(f"{about} is missing; the chart makes it: helm upgrade brings it back, or make it, empty")


def _files(pair: Pair) -> dict[str, str]:
    return {CERTIFICATE: pair.certificate, KEY: pair.key}


def _pair(data: Mapping[str, str]) -> Pair | None:
    """The pair in a Secret; None when a part of it is missing or is no text."""
    try:
        certificate, key = (base64.b64decode(data.get(name) or "").decode("ascii") for name in (CERTIFICATE, KEY))
    except (binascii.Error, UnicodeDecodeError):
        return None
    return Pair(certificate, key) if certificate and key else None
