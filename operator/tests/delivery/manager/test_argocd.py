"""Asking Argo CD again, against a server that plays its session and refresh endpoints."""

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

from robotkube.delivery.manager.adapters.argocd import ArgoCDServer
from robotkube.foundation.forge.adapters.push_hooks import SignedPushHook


class Server:
    """Tokens are valid until `expire`; requests are kept as (method, path, token)."""

    def __init__(self) -> None:
        self.requests: list[tuple[str, str, str]] = []
        self.tokens = 0
        self.status = 200
        outer = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_POST(self) -> None:
                body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                good = self.path == "/api/v1/session" and body == {"username": "manager", "password": "word"}
                outer.tokens += 1
                self.answer(200 if good else 401, {"token": f"t{outer.tokens}"})

            def do_GET(self) -> None:
                token = self.headers.get("Authorization", "").removeprefix("Bearer ")
                outer.requests.append(("GET", self.path, token))
                self.answer(outer.status if token == f"t{outer.tokens}" else 401, {})

            def answer(self, status: int, document: dict[str, Any]) -> None:
                body = json.dumps(document).encode()
                self.send_response(status)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True).start()
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}"

    def expire(self) -> None:
        self.tokens += 1

    def stop(self) -> None:
        self._server.shutdown()
        self._server.server_close()


@pytest.fixture
def server() -> Iterator[Server]:
    started = Server()
    yield started
    started.stop()


def connect(url: str, password: str = "word") -> ArgoCDServer:  # noqa: S107
    return ArgoCDServer(url, "manager", password, SignedPushHook(f"{url}/hook", b"x", url), "robotkube-apps")


def test_it_logs_in_once_and_again_when_the_token_has_run_out(server: Server) -> None:
    argocd = connect(server.url)
    assert argocd.refresh("cloud-0-bridge")
    assert argocd.refresh("cloud-0-bridge")
    assert server.tokens == 1
    path = "/api/v1/applications/cloud-0-bridge?refresh=normal&project=robotkube-apps"
    assert server.requests[0] == ("GET", path, "t1")
    server.expire()
    assert argocd.refresh("cloud-0-bridge")
    assert server.tokens == 3
    argocd.disconnect()


def test_a_refusal_and_silence_are_not_received(server: Server) -> None:
    argocd = connect(server.url)
    server.status = 403
    assert not argocd.refresh("unknown")
    argocd.disconnect()
    wrong = connect(server.url, "wrong")
    assert not wrong.refresh("cloud-0-bridge")
    wrong.disconnect()
    silent = connect("http://127.0.0.1:9")
    assert not silent.refresh("cloud-0-bridge")
    assert not silent.hook("a", "b")
    silent.disconnect()
