"""A kubelet's server over real TLS, for who asks kubelets."""

from __future__ import annotations

import contextlib
import json
import ssl
import subprocess
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from robotkube.foundation.kubernetes.adapters.kubelet_client import KubeletClient


class ServedKubelet:
    """A kubelet at 127.0.0.1: `status` and `answers` by path (bytes: as they are); what was asked with which token."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.status = 200
        self.answers: dict[str, Any] = {}
        self.asked: list[tuple[str, str]] = []
        self.connections = 0
        words = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
        files = ["-keyout", str(folder / "key"), "-out", str(folder / "certificate")]
        names = ["-subj", "/CN=kubelet", "-addext", "subjectAltName=IP:127.0.0.1"]
        subprocess.run([*words, *names, *files], check=True, capture_output=True, timeout=30)
        (folder / "token").write_text("secret\n")

    @contextlib.contextmanager
    def served(self) -> Iterator[int]:
        """Its port."""
        server = ThreadingHTTPServer(("127.0.0.1", 0), self._handler())
        server.daemon_threads = True
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(self.folder / "certificate", self.folder / "key")
        server.socket = context.wrap_socket(server.socket, server_side=True, do_handshake_on_connect=False)
        thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
        thread.start()
        try:
            yield server.server_address[1]
        finally:
            server.shutdown()
            server.server_close()

    @contextlib.contextmanager
    def client(self, authority: bool = True, right: str = "do this") -> Iterator[KubeletClient]:
        """A client with its token, which checks its certificate, or none."""
        certificate = self.folder / "certificate" if authority else None
        with contextlib.closing(KubeletClient(right, certificate, self.folder / "token")) as client:
            yield client

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        kubelet = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"
            timeout = 5

            def setup(self) -> None:
                super().setup()
                kubelet.connections += 1

            def do_GET(self) -> None:
                kubelet.asked.append((self.path, self.headers["Authorization"]))
                answer = kubelet.answers.get(self.path)
                body = answer if isinstance(answer, bytes) else json.dumps(answer).encode()
                self.send_response(kubelet.status)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: Any) -> None:
                """Say nothing."""

        return Handler
