"""The certificate authorities by which HTTPS servers are believed, read once in a process for all of its clients."""

from __future__ import annotations

import functools
import ssl

import httpx


@functools.cache
def certificate_authorities(trust_env: bool = True) -> ssl.SSLContext:
    """What an httpx client reads by itself, each client anew, which costs 30 ms of a processor also where it speaks
    plain HTTP. `trust_env`: as the client's, whether variables of the environment may name others."""
    return httpx.create_ssl_context(trust_env=trust_env)
