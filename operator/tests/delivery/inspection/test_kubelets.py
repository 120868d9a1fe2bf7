"""Kubelets over real TLS: what they list, what they refuse, and certificates that are not the cluster's."""

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

import pytest

from robotkube.delivery.inspection.adapters.kubelets import Kubelets
from robotkube.delivery.inspection.ports import NodeAddress
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer
from tests.stages.delivery.inspected_node import pod_object


class Kubelet:
    """A kubelet's server: `status` and `answers` by path; what was asked with which token."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.status = 200
        self.answers: dict[str, Any] = {
            "/pods": {"items": [pod_object()]},
            "/runningpods/": {"items": [{"metadata": {"uid": "u1"}, "spec": {"containers": [{"name": "detector"}]}}]},
        }
        self.asked: list[tuple[str, str]] = []
        self.connections = 0
        words = ["-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=kubelet"]
        files = ["-keyout", str(folder / "key"), "-out", str(folder / "certificate")]
        names = ["-addext", "subjectAltName=IP:127.0.0.1"]
        subprocess.run(["openssl", "req", *words, *files, *names], check=True, capture_output=True, timeout=30)
        (folder / "token").write_text("secret\n")

    @contextlib.contextmanager
    def served(self) -> Iterator[NodeAddress]:
        server = ThreadingHTTPServer(("127.0.0.1", 0), self._handler())
        server.daemon_threads = True
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(self.folder / "certificate", self.folder / "key")
        server.socket = context.wrap_socket(server.socket, server_side=True, do_handshake_on_connect=False)
        thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
        thread.start()
        try:
            yield NodeAddress("a", "127.0.0.1", server.server_address[1])
        finally:
            server.shutdown()
            server.server_close()

    def reader(self, authority: bool = True) -> Kubelets:
        return Kubelets(
            ApiServer("http://127.0.0.1:1"),
            self.folder / "certificate" if authority else None,
            self.folder / "token",
        )

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
                body = json.dumps(kubelet.answers.get(self.path)).encode()
                self.send_response(kubelet.status)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: Any) -> None:
                """Say nothing."""

        return Handler


@pytest.fixture
def kubelet(tmp_path: Path) -> Kubelet:
    return Kubelet(tmp_path)


def test_both_lists_are_read_over_one_connection(kubelet: Kubelet) -> None:
    with kubelet.served() as node, contextlib.closing(kubelet.reader()) as reader:
        for _ in range(2):
            reading = reader.read(node)
    assert [pod.name for pod in reading.pods] == ["detector-5d9c7b-x"]
    assert [pod.containers for pod in reading.running] == [(("detector", ""),)]
    assert kubelet.asked == [("/runningpods/", "Bearer secret"), ("/pods", "Bearer secret")] * 2
    assert kubelet.connections == 1


@pytest.mark.parametrize("status", [401, 403])
def test_a_refusal_says_which_right_is_missing(kubelet: Kubelet, status: int) -> None:
    kubelet.status = status
    words = rf"refused \({status}\); let the account get nodes/pods"
    with (
        kubelet.served() as node,
        contextlib.closing(kubelet.reader()) as reader,
        pytest.raises(InputError, match=words),
    ):
        reader.read(node)


def test_a_certificate_that_is_not_the_clusters_is_said_with_the_fix(kubelet: Kubelet, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    with kubelet.served() as node:
        strict = Kubelets(ApiServer("http://127.0.0.1:1"), Kubelet(other).folder / "certificate", tmp_path / "token")
        with (
            contextlib.closing(strict),
            pytest.raises(InputError, match=r"its certificate is not trusted: .*kubelets\.verify: false"),
        ):
            strict.read(node)
        with contextlib.closing(kubelet.reader(authority=False)) as reader:
            assert reader.read(node).pods


@pytest.mark.parametrize(
    ("status", "answer", "words"),
    [
        (500, None, "500"),
        (200, [1], "no list of pods"),
        (200, {"items": [1]}, "what it lists is no list of pods"),
        (200, {"items": [{"spec": {"containers": ["x"]}}]}, "what it lists is no list of pods"),
    ],
)
def test_nonsense_is_no_answer(kubelet: Kubelet, status: int, answer: Any, words: str) -> None:
    kubelet.status = status
    kubelet.answers["/pods"] = answer
    with (
        kubelet.served() as node,
        contextlib.closing(kubelet.reader()) as reader,
        pytest.raises(UnavailableError, match=words),
    ):
        reader.read(node)


def test_nobody_answers(kubelet: Kubelet) -> None:
    with kubelet.served() as node:
        pass
    with (
        contextlib.closing(kubelet.reader()) as reader,
        pytest.raises(UnavailableError, match="kubelet of node a"),
    ):
        reader.read(node)
