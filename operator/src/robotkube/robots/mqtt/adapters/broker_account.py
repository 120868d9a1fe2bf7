"""An account at a broker, and how the broker proves who it is; read from the files of the Secret `broker-account`:
`<folder>/host`, `port`, `username`, `password`, and those of `foundation.certificates.adapters.account_files`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.account_files import read_verification
from robotkube.foundation.certificates.adapters.verification import ServerVerification
from robotkube.foundation.runtime.process import read_secret


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
    return BrokerAccount(host, int(port), username, password, read_verification(folder, host))
