"""Requests to an application in the test's own process, one after the other, with the cookies of a browser."""

from __future__ import annotations

import asyncio
from typing import Any

import httpx
from starlette.types import ASGIApp

SOURCE = ("192.0.2.1", 50000)


class Client:
    """Somebody who asks `app`. Answers are read to their end, so a stream has to have one."""

    def __init__(self, app: ASGIApp, base_url: str = "http://testserver") -> None:
        transport = httpx.ASGITransport(app, client=SOURCE)
        self._client = httpx.AsyncClient(transport=transport, base_url=base_url, follow_redirects=False)

    @property
    def cookies(self) -> httpx.Cookies:
        """What the browser keeps."""
        return self._client.cookies

    def request(self, method: str, path: str, **more: Any) -> httpx.Response:
        """Ask and wait for the answer."""
        return asyncio.run(self._client.request(method, path, **more))

    def get(self, path: str, **more: Any) -> httpx.Response:
        """Ask by GET."""
        return self.request("GET", path, **more)

    def post(self, path: str, **more: Any) -> httpx.Response:
        """Ask by POST."""
        return self.request("POST", path, **more)
