"""An account at a broker, and how both prove who they are; read from the files of the Secret `broker-account`:
`<folder>/host`, `port`, `username`, `password`, and those of `foundation.certificates.adapters.account_files`."""

from __future__ import annotations

import ssl
from dataclasses import dataclass
from pathlib import Path

from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.account_files import read_own_certificate, read_verification
from robotkube.foundation.certificates.adapters.verification import (
    ClientCertificate,
    ServerVerification,
    client_context,
)
from robotkube.foundation.runtime.process import read_secret


@dataclass(frozen=True)
class BrokerAccount:
    """An account at a broker: its address and credentials. `tls` None: the connection is in clear text. With a
    `certificate` that proves the account, and the password is sent to nobody: client ids are made of it alone."""

    host: str
    port: int
    username: str
    password: str
    tls: ServerVerification | None = None
    certificate: ClientCertificate | None = None

    def context(self) -> ssl.SSLContext | None:
        """The context of a connection, by the files as they are now; None in clear text. InputError names the file that
        cannot be read."""
        return None if self.tls is None else client_context(self.tls, self.certificate)

    @property
    def login(self) -> tuple[str, str] | None:
        """Name and password as they are sent; None where a certificate says them."""
        return (self.username, self.password) if self.certificate is None else None


def read_broker_account(folder: Path) -> BrokerAccount:
    """The account in the Secret mounted at `folder`; InputError names the file that is missing or wrong."""
    port = read_secret(folder, "port")
    if not port.isdecimal():
        raise InputError(f"{folder / 'port'}: {port!r} is no port number")
    host, username, password = (read_secret(folder, key) for key in ("host", "username", "password"))
    tls = read_verification(folder, host)
    certificate = read_own_certificate(folder)
    if certificate is not None and tls is None:
        raise InputError(f"{folder / 'tls'}: must be required, since {folder / 'identity'} is certificate")
    return BrokerAccount(host, int(port), username, password, tls, certificate)
