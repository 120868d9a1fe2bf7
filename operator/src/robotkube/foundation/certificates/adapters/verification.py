"""Verification of a server by TLS (ssl): its certificate is of an authority in a file, and for the name one asked for.
And of oneself, where the server asks for it.

verification = ServerVerification(Path("/var/run/secrets/robotkube/broker/ca.crt"), "broker.robotkube.svc")
context = client_context(verification)        # for wrap_socket, or for whatever library takes a context
context = client_context(verification, ClientCertificate(Path("/var/run/secrets/robotkube/broker")))
sentence(error, verification)                 # what was refused and what to do, of an OSError that it raised
"""

from __future__ import annotations

import contextlib
import socket
import ssl
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.certificates.core.refusals import refused_certificate

PLAIN_ANSWERS = frozenset(["WRONG_VERSION_NUMBER", "RECORD_LAYER_FAILURE", "PACKET_LENGTH_TOO_LONG", "HTTP_REQUEST"])


@dataclass(frozen=True)
class ServerVerification:
    """How a server proves itself: by a certificate for `name`, of an authority in the PEM file `authorities`."""

    authorities: Path
    name: str


@dataclass(frozen=True)
class ClientCertificate:
    """How a client proves itself: by tls.crt and tls.key in a folder, as they are at each connection."""

    folder: Path


class _ClosedOnFailure(ssl.SSLSocket):
    """A socket that whoever drops it after a failed handshake leaves closed: paho forgets it."""

    def do_handshake(self, block: bool = False) -> None:
        try:
            super().do_handshake(block)
        except (ssl.SSLWantReadError, ssl.SSLWantWriteError):
            raise
        except OSError:
            self.close()
            raise


class _NamedContext(ssl.SSLContext):
    """A context that asks for one name, whatever address is connected to."""

    name = ""

    def wrap_socket(self, *arguments: Any, **options: Any) -> ssl.SSLSocket:
        return super().wrap_socket(*arguments, **{**options, "server_hostname": self.name})


def client_context(verification: ServerVerification, own: ClientCertificate | None = None) -> ssl.SSLContext:
    """The context of a client; InputError when the file of authorities is missing, or holds none, or `own` certificate
    cannot be read."""
    context = _NamedContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.name = verification.name
    context.sslsocket_class = _ClosedOnFailure
    load_authorities(context, verification)
    if own is not None:
        load_own(context, own)
    return context


def load_own(context: ssl.SSLContext, own: ClientCertificate) -> None:
    """Prove oneself by what the files have now. InputError names the folder where they cannot be read."""
    try:
        context.load_cert_chain(own.folder / "tls.crt", own.folder / "tls.key")
    except OSError as error:  # ssl.SSLError is one
        raise InputError(
            f"{own.folder}: no certificate of this account can be read in tls.crt and tls.key "
            f"({error.strerror or error}); the Deployment certificates fills its Secret, and the kubelet brings it "
            "within two minutes"
        ) from error


def alert_of(host: str, port: int, context: ssl.SSLContext, seconds: float) -> str:
    """The alert with which a server ends a connection on which nobody says anything, as OpenSSL names it; empty when it
    does not within `seconds`. Of TLS 1.3, what a server thinks of the client's certificate comes after the handshake,
    and is lost when something was sent meanwhile."""
    with contextlib.suppress(OSError), socket.create_connection((host, port), seconds) as plain:
        try:
            with context.wrap_socket(plain) as encrypted:
                encrypted.recv(1)
        except ssl.SSLError as error:
            return error.reason or ""
    return ""


def load_authorities(context: ssl.SSLContext, verification: ServerVerification) -> None:
    """Trust what the file names now, besides what was trusted before. InputError as above."""
    try:
        context.load_verify_locations(cafile=verification.authorities)
    except OSError as error:  # ssl.SSLError is one
        raise InputError(
            f"{verification.authorities}: no authority can be read there ({error.strerror or error}); it comes from "
            "ConfigMap robotkube-ca of this namespace, key ca.crt"
        ) from error


def sentence(error: OSError, verification: ServerVerification) -> str:
    """What an attempt to connect met, in words."""
    if isinstance(error, ssl.SSLCertVerificationError):
        words = error.verify_message
        return refused_certificate(error.verify_code, words, verification.name, str(verification.authorities))
    if isinstance(error, ssl.SSLError) and error.reason in PLAIN_ANSWERS:
        return (
            "it does not speak TLS at this port; name the port that does (broker 8883, database 27018), or let it; a "
            "forge or a process of the platform in clear text has an address that begins with http://"
        )
    return str(error) or type(error).__name__
