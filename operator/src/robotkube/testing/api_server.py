"""A small API server in memory, served over real HTTP: ConfigMaps and custom resources, with list and watch.

Objects have resourceVersions and merge patches; there are no accounts and no schemas.

    with ApiServerInMemory() as server:
        server.put_config_map("vehicle-00", "simulation", {"run": "1", "start": "0"})
        environment["ROBOTKUBE_API_SERVER"] = server.url
"""

from __future__ import annotations

import contextlib
import json
import re
import socket
import threading
import time
from collections.abc import Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, ClassVar
from urllib.parse import parse_qs, urlsplit

WATCH_SECONDS_MAX = 300.0
EVENTS_MAX = 10_000

_PATH = re.compile(r"(/api/v1|/apis/[^/]+/[^/]+)/namespaces/([^/]+)/([a-z]+)(?:/([^/]+))?(?:/status)?")


class ApiServerInMemory:
    """An API server that serves within a with block."""

    def __init__(self, address: str = "127.0.0.1", port: int = 0) -> None:
        self._lock = threading.Condition()
        self._objects: dict[tuple[str, str], dict[str, Any]] = {}  # (list path, name)
        self._events: list[tuple[int, str, str, dict[str, Any]]] = []  # version, list path, type, object
        self._version = 1
        self._closed = False
        self._connections: set[socket.socket] = set()
        self._server = ThreadingHTTPServer((address, port), _handler(self))
        self._server.daemon_threads = True

    def __enter__(self) -> ApiServerInMemory:
        threading.Thread(target=self._server.serve_forever, args=(0.05,), name="api-server", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._closed = True
            self._lock.notify_all()
        self._server.shutdown()
        for connection in list(self._connections):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
        self._server.server_close()

    def note_connection(self, connection: socket.socket, is_open: bool) -> None:
        """Note a connection, which is ended with the server."""
        (self._connections.add if is_open else self._connections.discard)(connection)

    @property
    def url(self) -> str:
        """The server's address."""
        host, port = self._server.server_address[:2]
        return f"http://{host!s}:{port}"

    def put_config_map(self, namespace: str, name: str, data: Mapping[str, str] | None) -> None:
        """Make or replace a ConfigMap; None deletes it."""
        folder = f"/api/v1/namespaces/{namespace}/configmaps"
        if data is None:
            self.delete(folder, name)
        else:
            self.put(folder, name, {"metadata": {"name": name, "namespace": namespace}, "data": dict(data)})

    def objects(self, folder: str) -> list[dict[str, Any]]:
        """All objects of a list path."""
        with self._lock:
            return [body for (place, _), body in self._objects.items() if place == folder]

    def get(self, folder: str, name: str) -> dict[str, Any] | None:
        """One object."""
        with self._lock:
            return self._objects.get((folder, name))

    def put(self, folder: str, name: str, body: dict[str, Any]) -> dict[str, Any]:
        """Make or replace an object."""
        with self._lock:
            kind = "MODIFIED" if (folder, name) in self._objects else "ADDED"
            self._version += 1
            metadata = {**body.get("metadata", {}), "name": name, "resourceVersion": str(self._version)}
            stored = {**body, "metadata": metadata}
            self._objects[(folder, name)] = stored
            self._note(folder, kind, stored)
            return stored

    def delete(self, folder: str, name: str) -> bool:
        """Remove an object; False when there was none."""
        with self._lock:
            stored = self._objects.pop((folder, name), None)
            if stored is not None:
                self._version += 1
                self._note(folder, "DELETED", stored)
            return stored is not None

    def listed(self, folder: str, name: str | None) -> dict[str, Any]:
        """The list, narrowed to one name."""
        with self._lock:
            items = [body for (place, key), body in self._objects.items() if place == folder and name in (None, key)]
            return {"kind": "List", "metadata": {"resourceVersion": str(self._version)}, "items": items}

    def events(self, folder: str, name: str | None, after: int, seconds: float) -> tuple[int, list[dict[str, Any]]]:
        """Events after a version; waits for the first one at most `seconds`."""
        deadline = time.monotonic() + seconds
        with self._lock:
            while not self._closed:
                events = [e for e in self._events if e[0] > after and e[1] == folder]
                events = [e for e in events if name in (None, e[3]["metadata"]["name"])]
                if events:
                    return events[-1][0], [{"type": kind, "object": body} for _, _, kind, body in events]
                if not self._lock.wait(max(0.0, deadline - time.monotonic())):
                    break
            return after, []

    def _note(self, folder: str, kind: str, body: dict[str, Any]) -> None:
        self._events.append((self._version, folder, kind, body))
        del self._events[:-EVENTS_MAX]
        self._lock.notify_all()


def merged(old: Any, patch: Any) -> Any:
    """JSON merge patch (RFC 7396)."""
    if not isinstance(patch, dict):
        return patch
    result = dict(old) if isinstance(old, dict) else {}
    for key, value in patch.items():
        if value is None:
            result.pop(key, None)
        else:
            result[key] = merged(result.get(key), value)
    return result


class _Handler(BaseHTTPRequestHandler):
    """Answers requests by what `api_server` holds."""

    api_server: ClassVar[ApiServerInMemory]
    protocol_version = "HTTP/1.1"

    def setup(self) -> None:
        super().setup()
        self.api_server.note_connection(self.connection, True)

    def finish(self) -> None:
        self.api_server.note_connection(self.connection, False)
        with contextlib.suppress(OSError):
            super().finish()

    def log_message(self, *_: object) -> None:
        """Quiet."""

    def do_GET(self) -> None:
        folder, name, query = self._address()
        selected = query.get("fieldSelector", [""])[0].removeprefix("metadata.name=") or None
        if name:
            body = self.api_server.get(folder, name)
            self._answer(200, body) if body else self._missing(name)
        elif "watch" in query:
            self._watch(folder, selected, query)
        else:
            self._answer(200, self.api_server.listed(folder, selected))

    def do_POST(self) -> None:
        folder, _, _ = self._address()
        body = self._body()
        name = body["metadata"]["name"]
        if self.api_server.get(folder, name):
            self._answer(409, {"kind": "Status", "reason": "AlreadyExists", "message": f"{name} already exists"})
        else:
            self._answer(201, self.api_server.put(folder, name, body))

    def do_PATCH(self) -> None:
        folder, name, _ = self._address()
        old = self.api_server.get(folder, name)
        patch = self._body()
        self._answer(200, self.api_server.put(folder, name, merged(old, patch))) if old else self._missing(name)

    def do_DELETE(self) -> None:
        folder, name, _ = self._address()
        self._answer(200, {"kind": "Status"}) if self.api_server.delete(folder, name) else self._missing(name)

    def _address(self) -> tuple[str, str, dict[str, list[str]]]:
        parts = urlsplit(self.path)
        match = _PATH.fullmatch(parts.path)
        if match is None:
            return parts.path, "", parse_qs(parts.query)
        base, namespace, plural, name = match.groups()
        return f"{base}/namespaces/{namespace}/{plural}", name or "", parse_qs(parts.query)

    def _body(self) -> Any:
        return json.loads(self.rfile.read(int(self.headers.get("Content-Length", 0))))

    def _missing(self, name: str) -> None:
        self._answer(404, {"kind": "Status", "reason": "NotFound", "message": f"{name} not found"})

    def _answer(self, status: int, body: object) -> None:
        data = json.dumps(body).encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def _watch(self, folder: str, name: str | None, query: dict[str, list[str]]) -> None:
        self.close_connection = True
        self.send_response(200)
        self.end_headers()
        deadline = time.monotonic() + min(float(query.get("timeoutSeconds", ["60"])[0]), WATCH_SECONDS_MAX)
        version = int(query.get("resourceVersion", ["0"])[0])
        while (left := deadline - time.monotonic()) > 0:
            reached, events = self.api_server.events(folder, name, version, left)
            if not events:
                return
            version = reached
            try:
                self.wfile.write("".join(json.dumps(event) + "\n" for event in events).encode())
            except OSError:
                return


def _handler(server: ApiServerInMemory) -> type[BaseHTTPRequestHandler]:
    """The class of handlers of one server."""
    return type("Handler", (_Handler,), {"api_server": server})
