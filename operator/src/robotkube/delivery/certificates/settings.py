"""Settings of the process that keeps certificates (docs/reference/settings.md)."""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.certificates.core.issuance import (
    AccountCertificate,
    AccountIssuance,
    Issuance,
    ServerCertificate,
)
from robotkube.foundation.documents.core.former_keys import FormerKey
from robotkube.foundation.documents.core.patterns import DNS_NAME, HTTP_URL, NAME, WORD
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.runtime import settings_file as files

LIFE_SECONDS_MIN = 10
LIFE_SECONDS_MAX = 825 * 86_400
FORMER_KEYS = (FormerKey("certificate", "certificates", convert=lambda one: [one]),)


@dataclass(frozen=True)
class CertificatesConfiguration:
    """Everything the process needs."""

    listen: files.Listen
    log_level: str
    issuance: Issuance


def read_configuration(reader: Reader, document: Mapping[str, Any]) -> CertificatesConfiguration:
    """The settings document of the process."""
    keys = ["listen", "log_level", "namespace", "authority", "certificates", "trusted"]
    root = reader.mapping(document, "", keys, ["accounts"])
    authority = reader.mapping(root.get("authority") or {}, "authority", ["secret"])
    trusted = reader.mapping(root.get("trusted") or {}, "trusted", ["config_map", "namespaces"])
    certificates = enumerate(reader.sequence(root.get("certificates"), "certificates"))
    namespaces = enumerate(reader.sequence(trusted.get("namespaces"), "trusted.namespaces"))
    issuance = Issuance(
        platform=reader.word(root.get("namespace"), "namespace", NAME),
        authority=reader.word(authority.get("secret"), "authority.secret", WORD),
        trusted=reader.word(trusted.get("config_map"), "trusted.config_map", WORD),
        namespaces=tuple(reader.word(one, f"trusted.namespaces[{i}]", NAME) for i, one in namespaces),
        certificates=tuple(_certificate(reader, one, f"certificates[{i}]") for i, one in certificates),
        accounts=_accounts(reader, root["accounts"]) if root.get("accounts") is not None else None,
    )
    secrets = [certificate.secret for certificate in issuance.certificates]
    if not secrets:
        reader.problems.append("certificates: must name the Secret of one server at least")
    if len(set(secrets)) < len(secrets) or issuance.authority in secrets:
        reader.problems.append("certificates: each needs a Secret of its own, which is not the authority's")
    return CertificatesConfiguration(
        listen=files.listen(reader, root.get("listen")),
        log_level=files.log_level(reader, root.get("log_level")),
        issuance=issuance,
    )


def _accounts(reader: Reader, value: Any) -> AccountIssuance:
    accounts = reader.mapping(value, "accounts", ["of", "life_seconds", "register", "shut"])
    of = enumerate(reader.sequence(accounts.get("of"), "accounts.of"))
    certificates = tuple(_account(reader, one, f"accounts.of[{i}]") for i, one in of)
    if len({certificate.account for certificate in certificates}) < len(certificates):
        reader.problems.append("accounts.of: names an account twice")
    return AccountIssuance(
        certificates,
        float(_life(reader, accounts.get("life_seconds"), "accounts.life_seconds")),
        reader.word(accounts.get("register"), "accounts.register", NAME),
        reader.word(accounts.get("shut"), "accounts.shut", HTTP_URL),
    )


def _account(reader: Reader, value: Any, path: str) -> AccountCertificate:
    account = reader.mapping(value, path, ["account", "secret", "namespace"], ["number", "reserved"])
    number, reserved = account.get("number", 0), account.get("reserved", False)
    if not isinstance(number, int) or isinstance(number, bool) or number < 0:
        reader.problems.append(f"{path}.number: must be a whole number from 0 on")
    if not isinstance(reserved, bool):
        reader.problems.append(f"{path}.reserved: must be true or false")
    return AccountCertificate(
        reader.word(account.get("account"), f"{path}.account", NAME),
        reader.word(account.get("secret"), f"{path}.secret", NAME),
        reader.word(account.get("namespace"), f"{path}.namespace", NAME),
        number if isinstance(number, int) else 0,
        bool(reserved),
    )


def _certificate(reader: Reader, value: Any, path: str) -> ServerCertificate:
    certificate = reader.mapping(value, path, ["secret", "names", "life_seconds"], ["service", "namespace"])
    names = reader.sequence(certificate.get("names"), f"{path}.names")
    if not names:
        reader.problems.append(f"{path}.names: must name the server")
    return ServerCertificate(
        secret=reader.word(certificate.get("secret"), f"{path}.secret", WORD),
        names=tuple(_name(reader, name, f"{path}.names[{i}]") for i, name in enumerate(names)),
        seconds=float(_life(reader, certificate.get("life_seconds"), f"{path}.life_seconds")),
        service=reader.word(certificate.get("service"), f"{path}.service", NAME, default=""),
        namespace=reader.word(certificate.get("namespace"), f"{path}.namespace", NAME, default=""),
    )


def _name(reader: Reader, value: Any, path: str) -> str:
    text = str(value)
    try:
        return str(ipaddress.ip_address(text))
    except ValueError:
        return reader.word(text, path, DNS_NAME)


def _life(reader: Reader, value: Any, path: str) -> int:
    if isinstance(value, int) and not isinstance(value, bool) and LIFE_SECONDS_MIN <= value <= LIFE_SECONDS_MAX:
        return value
    reader.problems.append(f"{path}: must be a whole number from {LIFE_SECONDS_MIN} to {LIFE_SECONDS_MAX}")
    return LIFE_SECONDS_MAX
