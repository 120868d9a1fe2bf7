"""An account at a broker, and how the broker proves who it is; read from the files of the Secret `broker-account`.

<folder>/host, port, username, password
<folder>/tls           `required`: encrypted, or no connection; `off`, or no such file: in clear text
<folder>/ca.crt        with `required`: the authorities: ConfigMap robotkube-ca, mounted beside the Secret's files
<folder>/server_name   where it is another one than the host: the name in the broker's certificate
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.verification import ServerVerification
from robotkube.foundation.runtime.process import read_secret

AUTHORITIES, TLS, SERVER_NAME = "ca.crt", "tls", "server_name"
REQUIRED, OFF = "required", "off"


@dataclass(frozen=True)
class BrokerAccount:
    """An account at a broker: its address and credentials. `tls` None: the connection is in clear text."""

    host: str
    port: int
    username: str
    password: str
    tls: ServerVerification | None = None


def read_broker_account(folder: Path) -> BrokerAccount:
    """The account in the Secret mounted at `folder`; InputError names the file that is missing or wrong."""
    port = read_secret(folder, "port")
    if not port.isdecimal():
        raise InputError(f"{folder / 'port'}: {port!r} is no port number")
    host, username, password = (read_secret(folder, key) for key in ("host", "username", "password"))
    return BrokerAccount(host, int(port), username, password, _verification(folder, host))


def _verification(folder: Path, host: str) -> ServerVerification | None:
    mode = read_secret(folder, TLS) if (folder / TLS).exists() else OFF
    if mode == OFF:
        return None
    if mode != REQUIRED:
        raise InputError(f"{folder / TLS}: {mode!r}; must be {REQUIRED} or {OFF}")
    name = read_secret(folder, SERVER_NAME) if (folder / SERVER_NAME).exists() else host
    return ServerVerification(folder / AUTHORITIES, name)
