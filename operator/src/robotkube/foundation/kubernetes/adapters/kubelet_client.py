"""Questions to kubelets over HTTPS, by the account's own token.

A kubelet asks the API server whether the account may `get nodes/<what is asked for>` (fine-grained authorization,
Kubernetes 1.33 and later). The same through the API server would need `nodes/proxy`, which runs commands in every
container.
"""

from __future__ import annotations

import http.client
import ssl
import threading
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json_shortened
from robotkube.foundation.kubernetes.adapters.http_client import ACCOUNT_FOLDER

PORT = 10250
TIMEOUT_SECONDS = 2.0
ANSWER_BYTES_MAX = 16 * 1024 * 1024
UNTRUSTED = "have kubelets' certificates signed by the cluster (serverTLSBootstrap), or set kubelets.verify: false"


class KubeletClient:
    """A client of all kubelets, for several threads; one connection to each is kept.

    `authority` checks their certificates (None: they are not checked: who is in the way between here and there can
    answer for them, and read the token). `right` says what to do when one refuses.
    """

    def __init__(
        self,
        right: str,
        authority: Path | None = ACCOUNT_FOLDER / "ca.crt",
        token_file: Path = ACCOUNT_FOLDER / "token",
        timeout_seconds: float = TIMEOUT_SECONDS,
    ) -> None:
        self._right = right
        self._authority = authority
        self._token_file = token_file
        self._timeout_seconds = timeout_seconds
        self._connections: dict[tuple[str, int], http.client.HTTPSConnection] = {}
        self._lock = threading.Lock()

    def get(self, kubelet: str, host: str, port: int, path: str) -> Mapping[str, Any]:
        """The document that a kubelet answers; `kubelet` names it in errors. InputError: it refuses, or is not the
        cluster's; UnavailableError: no answer, or none that is a document."""
        what = f"{kubelet} ({host}:{port}), GET {path}"
        try:
            status, data = self._exchange(host, port, path)
        except ssl.SSLCertVerificationError as error:
            words = f"its certificate is not trusted: {error.verify_message}"
            raise InputError(f"{what}: {words}; {UNTRUSTED}") from error
        except (OSError, http.client.HTTPException) as error:
            raise UnavailableError(f"{what}: {error or type(error).__name__}") from error
        if status in (401, 403):
            raise InputError(f"{what}: refused ({status}); {self._right}")
        if status != 200:
            raise UnavailableError(f"{what}: {status} {data[:200].decode(errors='replace').strip()}")
        return _document(data, what)

    def close(self) -> None:
        """Give kept connections back; the next question makes a new one."""
        with self._lock:
            kept = list(self._connections.values())
            self._connections.clear()
        for connection in kept:
            connection.close()

    def _exchange(self, host: str, port: int, path: str) -> tuple[int, bytes]:
        """Ask on the kept connection; when the kubelet closed that meanwhile, once more on a new one."""
        with self._lock:
            kept = self._connections.pop((host, port), None)
        if kept is not None:
            try:
                return self._ask(kept, path)
            except (OSError, http.client.HTTPException):
                kept.close()
        made = http.client.HTTPSConnection(host, port, timeout=self._timeout_seconds, context=self._context)
        try:
            return self._ask(made, path)
        except (OSError, http.client.HTTPException):
            made.close()
            raise

    def _ask(self, connection: http.client.HTTPSConnection, path: str) -> tuple[int, bytes]:
        token = self._token_file.read_text(encoding="utf-8").strip()
        connection.request("GET", path, headers={"Authorization": f"Bearer {token}"})
        response = connection.getresponse()
        data = response.read(ANSWER_BYTES_MAX)
        if response.isclosed():
            with self._lock:
                self._connections[connection.host, connection.port] = connection
        else:
            connection.close()
        return response.status, data

    @cached_property
    def _context(self) -> ssl.SSLContext:
        if self._authority:
            return ssl.create_default_context(cafile=self._authority)
        context = ssl.create_default_context()
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
        return context


def _document(data: bytes, what: str) -> Mapping[str, Any]:
    try:
        document = read_json_shortened(data)
    except ValueError as error:
        raise UnavailableError(f"{what}: no JSON of at most {ANSWER_BYTES_MAX} bytes: {error}") from error
    if not isinstance(document, dict):
        raise UnavailableError(f"{what}: no document")
    return document
