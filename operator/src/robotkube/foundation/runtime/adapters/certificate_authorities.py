"""The certificate authorities by which HTTPS servers are believed, read once in a process for all of its clients."""

from __future__ import annotations

import functools
import ssl
from pathlib import Path

import httpx

from robotkube.errors import InputError


@functools.cache
def certificate_authorities(trust_env: bool = True, more: Path | None = None) -> ssl.SSLContext:
    """What an httpx client reads by itself, each client anew, which costs 30 ms of a processor also where it speaks
    plain HTTP. `trust_env`: as the client's, whether variables of the environment may name others. `more`: a file with
    authorities (PEM) that are believed as well; InputError when it has none."""
    context = httpx.create_ssl_context(trust_env=trust_env)
    if more is not None:
        try:
            context.load_verify_locations(cafile=more)
        except (OSError, ssl.SSLError) as error:
            raise InputError(f"{more}: no certificate of an authority as PEM ({error})") from error
    return context
