"""Settings of the process that keeps certificates (docs/reference/settings.md)."""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.certificates.core.issuance import Issuance
from robotkube.foundation.documents.core.patterns import DNS_NAME, NAME, WORD
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.runtime import settings_file as files

LIFE_SECONDS_MIN, LIFE_SECONDS_MAX = 10, 825 * 86_400


@dataclass(frozen=True)
class CertificatesConfiguration:
    """Everything the process needs."""

    listen: files.Listen
    log_level: str
    issuance: Issuance


def read_configuration(reader: Reader, document: Mapping[str, Any]) -> CertificatesConfiguration:
    """The settings document of the process."""
    root = reader.mapping(document, "", ["listen", "log_level", "namespace", "authority", "certificate", "trusted"])
    authority = reader.mapping(root.get("authority") or {}, "authority", ["secret"])
    certificate = reader.mapping(root.get("certificate") or {}, "certificate", ["secret", "names", "life_seconds"])
    trusted = reader.mapping(root.get("trusted") or {}, "trusted", ["config_map", "namespaces"])
    names = reader.sequence(certificate.get("names"), "certificate.names")
    namespaces = enumerate(reader.sequence(trusted.get("namespaces"), "trusted.namespaces"))
    if not names:
        reader.problems.append("certificate.names: must name the broker")
    return CertificatesConfiguration(
        listen=files.listen(reader, root.get("listen")),
        log_level=files.log_level(reader, root.get("log_level")),
        issuance=Issuance(
            platform=reader.word(root.get("namespace"), "namespace", NAME),
            authority=reader.word(authority.get("secret"), "authority.secret", WORD),
            certificate=reader.word(certificate.get("secret"), "certificate.secret", WORD),
            trusted=reader.word(trusted.get("config_map"), "trusted.config_map", WORD),
            namespaces=tuple(reader.word(one, f"trusted.namespaces[{i}]", NAME) for i, one in namespaces),
            names=tuple(_name(reader, name, f"certificate.names[{i}]") for i, name in enumerate(names)),
            seconds=float(_life(reader, certificate.get("life_seconds"))),
        ),
    )


def _name(reader: Reader, value: Any, path: str) -> str:
    text = str(value)
    try:
        return str(ipaddress.ip_address(text))
    except ValueError:
        return reader.word(text, path, DNS_NAME)


def _life(reader: Reader, value: Any) -> int:
    if isinstance(value, int) and not isinstance(value, bool) and LIFE_SECONDS_MIN <= value <= LIFE_SECONDS_MAX:
        return value
    bounds = f"{LIFE_SECONDS_MIN} to {LIFE_SECONDS_MAX}"
    reader.problems.append(f"certificate.life_seconds: must be a whole number from {bounds}")
    return LIFE_SECONDS_MAX
