"""Encrypted connections to the database: what pymongo takes for a context of TLS.

pymongo asks a certificate for the address that it connects to, and reads authorities once. Here the name is the
account's, since a Service and a test namespace are also reached by address, and the file is read at each connection.
"""

from __future__ import annotations

import socket
import ssl
from typing import Any

from pymongo import MongoClient

from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.verification import ServerVerification, client_context, sentence


class _Context:
    """The part of an `ssl.SSLContext` that pymongo uses."""

    check_hostname = True
    verify_mode = ssl.CERT_REQUIRED

    def __init__(self, verification: ServerVerification) -> None:
        self._verification = verification

    def wrap_socket(self, connection: socket.socket, server_hostname: str = "") -> ssl.SSLSocket:
        """The connection after its handshake; OSError says what was refused, and what to do."""
        try:
            return client_context(self._verification).wrap_socket(connection)
        except InputError as error:
            raise ConnectionError(str(error)) from error
        except OSError as error:
            raise ConnectionError(sentence(error, self._verification)) from error


def encrypt(client: MongoClient[Any], verification: ServerVerification) -> None:
    """Let a client that has not connected yet (`connect=False`) speak TLS alone, with a server that proves itself."""
    options = client.options.pool_options
    options._PoolOptions__ssl_context = _Context(verification)  # type: ignore[attr-defined]  # pymongo takes no context
