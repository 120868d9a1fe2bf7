"""An OCI registry in this process that answers as ghcr.io, GitLab or a newer one do: it asks who one is, for a token or
for the account itself, and may list what is attached by itself."""

from __future__ import annotations

import base64
import json
import re
import threading
import urllib.parse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from robotkube.foundation.documents.core.digests import canonical_json, sha256
from robotkube.registry.charts.core.referrers import INDEX_TYPE, entry_of

USER, PASSWORD = "robot", "its-password"
ACCOUNT = f"Basic {base64.b64encode(f'{USER}:{PASSWORD}'.encode()).decode()}"
PATH = re.compile(r"/v2/(?P<name>.+?)/(?P<kind>manifests|blobs|referrers|tags)/(?P<reference>.*)")


@dataclass
class AskingRegistry:
    """How it asks (`tokens`, `basic`), and what it has and saw. `lists`: whether it has the referrers API, `page`: how
    many one answer of it names. `seconds`: how long a token is good for by its answer."""

    tokens: bool = True
    basic: bool = False
    anonymous: bool = False
    lists: bool = True
    page: int = 100
    seconds: int | None = 300
    realm: str = ""
    url: str = ""
    manifests: dict[tuple[str, str], bytes] = field(default_factory=dict)
    blobs: dict[tuple[str, str], bytes] = field(default_factory=dict)
    asked: list[dict[str, list[str]]] = field(default_factory=list)
    given: dict[str, list[str]] = field(default_factory=dict)
    seen: list[tuple[str, str, str]] = field(default_factory=list)  # method, path, scheme of the authorisation
    refused: int = 0

    def forget_tokens(self) -> None:
        """As when all of them have ended."""
        self.given.clear()

    def referrers(self, name: str, subject: str) -> list[dict[str, Any]]:
        """What of a repository is attached to a manifest."""
        listed = {}
        for (repository, _), data in self.manifests.items():
            if repository == name and json.loads(data).get("subject", {}).get("digest") == subject:
                listed[sha256(data)] = entry_of(data, "referrer")
        return [listed[digest] for digest in sorted(listed)]

    def needed(self, method: str, path: str) -> str:
        """The scope that a request needs."""
        match = PATH.match(urllib.parse.urlsplit(path).path)
        actions = {"GET": "pull", "HEAD": "pull", "DELETE": "delete"}.get(method, "pull,push")
        return f"repository:{match['name']}:{actions}" if match else ""

    def lets(self, method: str, path: str, authorisation: str) -> bool:
        """Return whether the request may be answered."""
        if self.basic and authorisation == ACCOUNT:
            return True
        if not self.tokens and not self.basic:
            return True
        scheme, _, token = authorisation.partition(" ")
        return scheme == "Bearer" and self.needed(method, path) in self.given.get(token, [])

    def token(self, question: dict[str, list[str]], authorisation: str) -> dict[str, Any] | None:
        """The answer of the place that gives tokens; None for an account that it does not know."""
        self.asked.append(question)
        if authorisation != ACCOUNT and not (self.anonymous and not authorisation):
            return None
        text = f"token-{len(self.asked)}"
        self.given[text] = question.get("scope", [])
        return {"token": text, **({"expires_in": self.seconds} if self.seconds else {})}


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    registry: AskingRegistry

    def do_GET(self) -> None:
        split = urllib.parse.urlsplit(self.path)
        if split.path == "/token":
            answer = self.registry.token(urllib.parse.parse_qs(split.query), self.headers.get("Authorization", ""))
            return self._say(200 if answer else 401, json.dumps(answer or {}).encode())
        if not self._welcome():
            return None
        match = PATH.match(split.path)
        if match is None:
            return self._say(404)
        if match["kind"] == "referrers":
            return self._referrers(match["name"], match["reference"], split.query)
        store = self.registry.manifests if match["kind"] == "manifests" else self.registry.blobs
        data = store.get((match["name"], match["reference"]))
        return self._say(404) if data is None else self._say(200, data)

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_POST(self) -> None:
        if self._welcome():
            self._say(202, headers={"Location": f"{urllib.parse.urlsplit(self.path).path}session"})

    def do_PUT(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        if not self._welcome():
            return None
        split = urllib.parse.urlsplit(self.path)
        match = PATH.match(split.path)
        assert match is not None
        if match["kind"] == "blobs":
            self.registry.blobs[match["name"], urllib.parse.parse_qs(split.query)["digest"][0]] = body
            return self._say(201)
        for reference in (match["reference"], sha256(body)):
            self.registry.manifests[match["name"], reference] = body
        return self._say(201)

    def _referrers(self, name: str, subject: str, query: str) -> None:
        if not self.registry.lists:
            return self._say(404)
        entries = self.registry.referrers(name, subject)
        first = int(urllib.parse.parse_qs(query).get("from", ["0"])[0])
        end = first + self.registry.page
        more = {"Link": f'</v2/{name}/referrers/{subject}?from={end}>; rel="next"'} if end < len(entries) else {}
        index = {"schemaVersion": 2, "mediaType": INDEX_TYPE, "manifests": entries[first:end]}
        return self._say(200, canonical_json(index), {"Content-Type": INDEX_TYPE, **more})

    def _welcome(self) -> bool:
        authorisation = self.headers.get("Authorization", "")
        self.registry.seen.append((self.command, self.path, authorisation.partition(" ")[0]))
        if self.registry.lets(self.command, self.path, authorisation):
            return True
        self.registry.refused += 1
        challenges = []
        if self.registry.tokens:
            scope = self.registry.needed(self.command, self.path)
            realm = self.registry.realm or f"{self.registry.url}/token"
            challenges.append(f'Bearer realm="{realm}",service="registry",scope="{scope}"')
        if self.registry.basic:
            challenges.append('Basic realm="registry"')
        self.send_response(401)
        for challenge in challenges:
            self.send_header("WWW-Authenticate", challenge)
        self.send_header("Content-Length", "0")
        self.end_headers()
        return False

    def _say(self, code: int, body: bytes = b"", headers: dict[str, str] | None = None) -> None:
        self.send_response(code)
        for name, value in {"Content-Length": str(len(body)), **(headers or {})}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        pass


@contextmanager
def running(registry: AskingRegistry) -> Iterator[AskingRegistry]:
    """The registry while it answers, with its address."""
    handler = type("Handler", (_Handler,), {"registry": registry})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    registry.url = f"http://127.0.0.1:{server.server_address[1]}"
    try:
        yield registry
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
