"""The key `broker` in the settings of the platform's processes: its address, the process's account, and how the broker
proves who it is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.account_files import read_own_certificate
from robotkube.foundation.certificates.settings import read_server_verification
from robotkube.foundation.documents.core.patterns import WORD
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.runtime import settings_file as files
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount


def read_broker(reader: Reader, value: Any) -> BrokerAccount:
    """`{host, port, credentials}`, and with TLS `authorities`: the file of those that may have signed for `host`. The
    folder `credentials` says itself whether a certificate proves the account."""
    broker = reader.mapping(value or {}, "broker", ["host", "port", "credentials"], ["authorities"])
    account = files.credentials(reader, broker.get("credentials"), "broker.credentials")
    host = reader.word(broker.get("host"), "broker.host", WORD)
    tls = read_server_verification(reader, broker.get("authorities"), "broker.authorities", host)
    try:
        certificate = read_own_certificate(Path(str(broker.get("credentials") or "")))
    except InputError as error:
        reader.problems.append(f"broker.credentials: {error}")
        certificate = None
    if certificate is not None and tls is None:
        reader.problems.append("broker.authorities: is missing, but a certificate proves the account; name the file")
    return BrokerAccount(host, _port(reader, broker), account.username, account.password, tls, certificate)


def _port(reader: Reader, broker: Mapping[str, Any]) -> int:
    port = broker.get("port")
    if isinstance(port, int) and not isinstance(port, bool) and 0 < port <= files.PORT_MAX:
        return port
    reader.problems.append(f"broker.port: must be a whole number from 1 to {files.PORT_MAX}")
    return 0
