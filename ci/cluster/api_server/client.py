"""The few calls to the API server that starting a cluster needs, over the standard library (no client to import)."""

from __future__ import annotations

import http.client
import json
import ssl
from pathlib import Path
from typing import Any

from ci.errors import SetUpError

TIMEOUT_SECONDS = 20
APPLY = "application/apply-patch+yaml"
MERGE = "application/merge-patch+json"
MANAGER = "fieldManager=robotkube-cluster&force=true"


class UnreachableError(Exception):
    """The API server does not answer (yet)."""


class Api:
    """Calls with the administrator's certificate; one connection within a `with` block; not for several threads."""

    def __init__(self, address: str, pki: Path) -> None:
        self.address = address
        self._context = ssl.create_default_context(cafile=str(pki / "ca.crt"))
        self._context.load_cert_chain(pki / "admin.crt", pki / "admin.key")
        self._connection: http.client.HTTPSConnection | None = None
        self._keep = False

    def __enter__(self) -> Api:
        """Keep the connection between calls."""
        self._keep = True
        return self

    def __exit__(self, *_: object) -> None:
        """Close the connection."""
        self._keep = False
        self._close()

    def ready(self) -> bool:
        """Return whether /readyz says ok."""
        try:
            return self._request("GET", "/readyz")[0] == http.client.OK
        except UnreachableError:
            return False

    def get(self, path: str) -> dict[str, Any]:
        """The object or list at `path`; raises SetUpError with the server's message."""
        return self._document("GET", path)

    def apply(self, path: str, manifest: dict[str, Any]) -> dict[str, Any]:
        """Server-side apply of `manifest` at `path` (with its name)."""
        return self._document("PATCH", f"{path}?{MANAGER}", json.dumps(manifest).encode(), APPLY)

    def merge(self, path: str, change: dict[str, Any]) -> dict[str, Any]:
        """Write these values into the object at `path`, and no others."""
        return self._document("PATCH", path, json.dumps(change).encode(), MERGE)

    def _document(self, method: str, path: str, body: bytes | None = None, kind: str = "") -> dict[str, Any]:
        try:
            status, answer = self._request(method, path, body, kind)
        except UnreachableError as error:
            raise SetUpError(f"the API server at {self.address} does not answer: {error}") from error
        if status >= http.client.BAD_REQUEST:
            raise SetUpError(f"{method} {path}: {status} {answer[:300].decode(errors='replace')}")
        document: dict[str, Any] = json.loads(answer)
        return document

    def _request(self, method: str, path: str, body: bytes | None = None, kind: str = "") -> tuple[int, bytes]:
        headers = {"Accept": "application/json"} | ({"Content-Type": kind} if kind else {})
        try:
            if self._connection is None:
                self._connection = http.client.HTTPSConnection(
                    self.address, 6443, context=self._context, timeout=TIMEOUT_SECONDS
                )
            self._connection.request(method, path, body, headers)
            response = self._connection.getresponse()
            return response.status, response.read()
        except (OSError, http.client.HTTPException) as error:
            self._close()
            raise UnreachableError(str(error)) from error
        finally:
            if not self._keep:
                self._close()

    def _close(self) -> None:
        if self._connection is not None:
            self._connection.close()
        self._connection = None
