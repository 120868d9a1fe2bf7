"""How server and client prove who they are, as the files of an account say it: beside host, port and password of a
mounted Secret.

<folder>/tls           `required`: encrypted, or no connection; `off`, or no such file: in clear text
<folder>/ca.crt        with `required`: the authorities: ConfigMap robotkube-ca, mounted beside the Secret's files
<folder>/server_name   where it is another one than the host: the name in the server's certificate
<folder>/identity      `certificate`: tls.crt and tls.key beside it prove the account, and its password is not sent;
                       `password`, or no such file: the password proves it
"""

from __future__ import annotations

from pathlib import Path

from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.verification import ClientCertificate, ServerVerification
from robotkube.foundation.runtime.process import read_secret

AUTHORITIES, TLS, SERVER_NAME, IDENTITY = "ca.crt", "tls", "server_name", "identity"
REQUIRED, OFF = "required", "off"
CERTIFICATE, PASSWORD = "certificate", "password"


def read_verification(folder: Path, host: str) -> ServerVerification | None:
    """How the server at `host` proves who it is; None: the connection is in clear text. InputError names the file that
    is wrong."""
    mode = read_secret(folder, TLS) if (folder / TLS).exists() else OFF
    if mode == OFF:
        return None
    if mode != REQUIRED:
        raise InputError(f"{folder / TLS}: {mode!r}; must be {REQUIRED} or {OFF}")
    name = read_secret(folder, SERVER_NAME) if (folder / SERVER_NAME).exists() else host
    return ServerVerification(folder / AUTHORITIES, name)


def read_own_certificate(folder: Path) -> ClientCertificate | None:
    """How the account is proved to the server; None: by its password. InputError names the file that is wrong."""
    identity = read_secret(folder, IDENTITY) if (folder / IDENTITY).exists() else PASSWORD
    if identity not in (CERTIFICATE, PASSWORD):
        raise InputError(f"{folder / IDENTITY}: {identity!r}; must be {CERTIFICATE} or {PASSWORD}")
    return ClientCertificate(folder) if identity == CERTIFICATE else None
