"""What stands in front of every request: names of hosts (a page of somebody else that lets its own name point here gets
nothing), how often one source may ask, and the headers that bound what a browser does with an answer."""

from __future__ import annotations

import ipaddress
import re
import time
from collections.abc import Callable, Collection, Mapping

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from robotkube.delivery.console.adapters.web.problems import ProblemError
from robotkube.delivery.console.core.rate_limits import RateLimits, RequestRate

POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self'",
        "connect-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
)
HEADERS: Mapping[str, str] = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "geolocation=(), camera=(), microphone=()",
}
HOST_HEADER = re.compile(r"(?:(?P<name>[A-Za-z0-9._-]+)|\[(?P<address>[0-9A-Fa-f:.]+)\])(?::\d{1,5})?", re.ASCII)
TRANSPORT = "max-age=31536000"
REQUESTS = RequestRate(burst=120, per_second=20)
SIGN_INS = RequestRate(burst=20, per_second=0.2)


class Guard:
    """The middleware. `encrypted`: browsers speak TLS with the console, also where a proxy ends it."""

    def __init__(
        self,
        app: ASGIApp,
        hosts: Collection[str],
        encrypted: bool,
        count: Callable[[int], None],
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._app = app
        self._hosts = frozenset(host.lower() for host in hosts)
        self._headers = {**HEADERS, **({"Strict-Transport-Security": TRANSPORT} if encrypted else {})}
        self._count = count
        self._monotonic = monotonic
        self._limits = {"/auth/": RateLimits(SIGN_INS), "/": RateLimits(REQUESTS)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse the request, or pass it on and add the headers to its answer."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                self._count(message["status"])
                MutableHeaders(scope=message).update(self._headers)
            await send(message)

        try:
            self._check(scope)
        except ProblemError as problem:
            await problem.response()(scope, receive, send_with_headers)
            return
        await self._app(scope, receive, send_with_headers)

    def _check(self, scope: Scope) -> None:
        name = host_name(Headers(scope=scope).get("host", ""))
        if name.lower() not in self._hosts and not _is_address(name):
            detail = f"The console does not go by the name {name[:100]!r}; name it in console.hosts."
            raise ProblemError(421, "Not this host", detail)
        source = scope["client"][0] if scope.get("client") else ""
        prefix = "/auth/" if scope["path"].startswith("/auth/") else "/"
        wait = self._limits[prefix].wait_seconds(source, self._monotonic())
        if wait:
            raise ProblemError(429, "Too many requests", "Wait a moment, then ask again.", wait)


def host_name(host: str) -> str:
    """The name in a header Host, without its port; empty when it is no name with a port or without one."""
    match = HOST_HEADER.fullmatch(host)
    return "" if match is None else match["name"] or match["address"]


def _is_address(name: str) -> bool:
    """Return whether it is no name but an address, which nobody can let point elsewhere."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
