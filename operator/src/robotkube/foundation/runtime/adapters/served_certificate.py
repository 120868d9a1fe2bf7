"""The certificate by which a server of this process proves who it is, as its mounted files have it at each connection.

certificate = ServedCertificate(Path("/var/run/secrets/robotkube/certificate"))      # a folder with tls.crt and tls.key
encrypted = certificate.wrap(accepted)        # at once, for it does not greet
greet(encrypted, 10.0)                        # on a thread of the connection's own
"""

from __future__ import annotations

import contextlib
import logging
import socket
import ssl
from pathlib import Path

from robotkube.errors import InputError

CERTIFICATE, KEY = "tls.crt", "tls.key"
CLEAR_TEXT = frozenset(["HTTP_REQUEST"])
SPEAKS_HTTPS = b'{"message": "this port speaks HTTPS; ask by an address that begins with https://"}\n'
ANSWER = (  # to HTTP
    b"HTTP/1.1 400 Bad Request\r\nConnection: close\r\nContent-Type: application/json\r\nContent-Length: %d\r\n\r\n%b"
) % (len(SPEAKS_HTTPS), SPEAKS_HTTPS)

log = logging.getLogger(__name__)


class ServedCertificate:
    """The certificate and key in a folder, of which each new connection gets those that are there by then.

    A renewed pair gets a context of its own, and the one before it goes on with its connections: none is lost, and none
    is greeted by the certificate of one pair with the key of the other. While the files do not belong together the last
    pair stays. Connections are wrapped by one thread. InputError when there is no pair at the start.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._changed = self._changed_at()
        self._refused = (0, 0)
        self._context = self._read()

    def wrap(self, connection: socket.socket) -> ssl.SSLSocket:
        """The connection with the certificate that is there now; nothing was sent or received yet."""
        changed = self._changed_at()
        if changed not in (self._changed, self._refused):
            self._renew(changed)
        return self._context.wrap_socket(connection, server_side=True, do_handshake_on_connect=False)

    def _renew(self, changed: tuple[int, int]) -> None:
        try:
            self._context = self._read()
        except InputError as error:
            self._refused = changed
            log.warning("certificate not renewed folder=%s reason=%s", self._folder, error)
            return
        self._changed = changed
        log.info("certificate renewed folder=%s", self._folder)

    def _changed_at(self) -> tuple[int, int]:
        """The time at which the files changed last, in ns since 1970; 0 while one is not there."""
        return _changed_at(self._folder / CERTIFICATE), _changed_at(self._folder / KEY)

    def _read(self) -> ssl.SSLContext:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        try:
            context.load_cert_chain(self._folder / CERTIFICATE, self._folder / KEY)
        except OSError as error:  # ssl.SSLError is one
            raise InputError(
                f"{self._folder}: {CERTIFICATE} and {KEY} are no certificate with its key ({error.strerror or error}); "
                "they come from the Secret that the pod mounts there"
            ) from error
        return context


def greet(connection: ssl.SSLSocket, seconds_max: float) -> None:
    """Agree with the client on keys, within that time; OSError when that fails. Who speaks HTTP is told so."""
    connection.settimeout(seconds_max)
    try:
        connection.do_handshake()
    except ssl.SSLError as error:
        if error.reason in CLEAR_TEXT:
            with contextlib.suppress(OSError):
                socket.socket.sendall(connection, ANSWER)
        raise


def _changed_at(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0
