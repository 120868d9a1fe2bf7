"""The certificate authorities by which HTTPS servers are believed, read once in a process for all of its clients.

trust(Path("/etc/robotkube/authorities/ca.crt"))      # beside the usual ones, in all of this process
httpx.Client(verify=certificate_authorities())
what_failed(error, url)                               # what an attempt to connect met, and what to do, in words
"""

from __future__ import annotations

import atexit
import functools
import shutil
import socket
import ssl
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.verification import ServerVerification, load_authorities, sentence

USUAL = Path("the list of authorities of this machine")
PROBE_SECONDS_MAX = 5.0
_trusted: dict[Path, None] = {}


class _Context(ssl.SSLContext):
    """A context that, at each handshake, also believes what its files have by then."""

    more: tuple[Path, ...] = ()
    _read: dict[Path, int]

    def wrap_socket(self, *arguments: Any, **options: Any) -> ssl.SSLSocket:
        self.read_files()
        return super().wrap_socket(*arguments, **options)

    def wrap_bio(self, *arguments: Any, **options: Any) -> ssl.SSLObject:
        self.read_files()
        return super().wrap_bio(*arguments, **options)

    def read_files(self) -> None:
        """Read files that are new or have changed. OSError, which clients take for a failed connection, names one that
        cannot be read."""
        for path in (*_trusted, *self.more):
            changed = changed_at(path)
            if self._read.get(path) == changed:
                continue
            try:
                load_authorities(self, ServerVerification(path, ""))
            except InputError as error:
                raise OSError(str(error)) from error
            self._read[path] = changed


def changed_at(path: Path) -> int:
    """The time at which a file changed last, in ns since 1970; 0 while it is not there."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


@functools.cache
def certificate_authorities(trust_env: bool = True, more: Path | None = None) -> ssl.SSLContext:
    """What an httpx client reads by itself, each client anew, which costs 30 ms of a processor also where it speaks
    plain HTTP, and beside that whom `trust` named. `trust_env`: as the client's, whether variables of the environment
    may name others. `more`: a file with authorities (PEM) that are believed as well; InputError when it has none."""
    import httpx  # whoever only says whom to trust need not wait for it

    context = httpx.create_ssl_context(trust_env=trust_env)
    context.__class__ = _Context
    assert isinstance(context, _Context)
    context._read = {}
    if more is not None:
        context.more = (more,)
        load_authorities(context, ServerVerification(more, ""))
    return context


def trust(*authorities: Path | None) -> None:
    """Believe the authorities in these files (PEM) in all of this process, besides the usual ones, also in contexts
    that are there already, and as they are at each handshake. InputError when one has none; None changes nothing."""
    for path in authorities:
        if path is not None:
            load_authorities(ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT), ServerVerification(path, ""))
            _trusted[path] = None


@functools.cache
def trust_text(authorities: str) -> None:
    """Trust, as `trust` does, PEM that stands in no file."""
    folder = Path(tempfile.mkdtemp(prefix="authorities-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    (folder / "ca.crt").write_text(authorities, encoding="ascii")
    trust(folder / "ca.crt")


def trusted() -> tuple[Path, ...]:
    """The files that `trust` named."""
    return tuple(_trusted)


def what_failed(error: BaseException, url: str) -> str:
    """What an attempt to reach `url` met, in words: of a refused certificate what to do, else the error's own."""
    refused = refused_handshake(error)
    if refused is not None:
        name = urlsplit(url).hostname or url
        return sentence(refused, ServerVerification(next(iter(_trusted), USUAL), name))
    return str(error) or type(error).__name__


def refused_handshake(error: BaseException) -> ssl.SSLError | None:
    """What OpenSSL said of a handshake that failed, if that is what an attempt to connect met."""
    return next((cause for cause in _causes(error) if isinstance(cause, ssl.SSLError)), None)


def refusal_of(url: str) -> str:
    """Why a handshake with the server at `url` fails now, in words; empty when it does not. For clients whose errors do
    not say what was refused."""
    address = urlsplit(url)
    try:
        with (
            socket.create_connection((address.hostname or "", address.port or 443), PROBE_SECONDS_MAX) as plain,
            certificate_authorities().wrap_socket(plain, server_hostname=address.hostname),
        ):
            return ""
    except OSError as error:
        return what_failed(error, url)


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
