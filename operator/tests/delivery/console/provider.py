"""A provider of accounts in the process: OpenID Connect with PKCE, as far as a client sees it."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from typing import Any
from urllib.parse import parse_qs, urlsplit

import httpx
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse
from starlette.routing import Route

from robotkube.delivery.console.core.signing_in import challenge

ISSUER = "https://forge.example"
CLIENT = "console-client"
NOW = 1_795_000_000


class AccountProvider:
    """The provider. `claims` are those of whoever signs in; each code is taken once, with its verifier alone. Browsers
    reach it at `pages`; `id_token` are further claims of ID tokens, which end when they are given, at NOW."""

    def __init__(self, **claims: Any) -> None:
        self.claims: Mapping[str, Any] = claims
        self.id_token: Mapping[str, Any] = {}
        self.pages = ISSUER
        self.userinfo_asked = 0
        self.secret = ""
        self.away = False
        self._codes: dict[str, tuple[str, str]] = {}
        routes = [
            Route("/.well-known/openid-configuration", self._discovery),
            Route("/token", self._token, methods=["POST"]),
            Route("/userinfo", self._userinfo),
        ]
        self._app = Starlette(routes=routes)

    def client(self) -> httpx.AsyncClient:
        """A connection to it."""
        transport = httpx.MockTransport(_unreachable) if self.away else httpx.ASGITransport(self._app)
        return httpx.AsyncClient(transport=transport)

    def consent(self, location: str) -> dict[str, str]:
        """What a browser brings back when the person at `location` agrees."""
        assert location.startswith(f"{self.pages}/authorize?"), location
        query = {name: values[0] for name, values in parse_qs(urlsplit(location).query).items()}
        assert (query["client_id"], query["response_type"], query["code_challenge_method"]) == (CLIENT, "code", "S256")
        code = f"code-{len(self._codes)}"
        self._codes[code] = (query["code_challenge"], query["redirect_uri"])
        return {"code": code, "state": query["state"]}

    async def _discovery(self, request: Request) -> JSONResponse:
        names = {"authorization": "authorize", "token": "token", "userinfo": "userinfo"}
        return JSONResponse({"issuer": ISSUER, **{f"{n}_endpoint": f"{ISSUER}/{path}" for n, path in names.items()}})

    async def _token(self, request: Request) -> JSONResponse:
        form = {name: values[0] for name, values in parse_qs((await request.body()).decode()).items()}
        asked, redirect = self._codes.pop(form["code"], ("", ""))
        genuine = challenge(form["code_verifier"]) == asked and form["redirect_uri"] == redirect
        if not genuine or form.get("client_secret", "") != self.secret:
            return JSONResponse({"error": "invalid_grant"}, 400)
        claims = {"iss": ISSUER, "aud": [CLIENT], "exp": NOW, **self.claims, **self.id_token}
        return JSONResponse({"access_token": "token", "token_type": "bearer", "id_token": json_web_token(claims)})

    async def _userinfo(self, request: Request) -> JSONResponse:
        self.userinfo_asked += 1
        assert request.headers["authorization"] == "Bearer token"
        return JSONResponse(dict(self.claims))


def json_web_token(claims: Mapping[str, Any]) -> str:
    """A token with these claims, whose signature nobody reads."""
    parts = ({"alg": "ES256"}, claims)
    encoded = [base64.urlsafe_b64encode(json.dumps(part).encode()).decode().rstrip("=") for part in parts]
    return ".".join([*encoded, "signature"])


def _unreachable(request: httpx.Request) -> httpx.Response:
    raise httpx.ConnectError("no route to host")
