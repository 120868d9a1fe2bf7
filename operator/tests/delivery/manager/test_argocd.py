"""Asking Argo CD again, against a server that plays its session and refresh endpoints, in clear text and by HTTPS."""

import json
import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from robotkube.delivery.manager.adapters.argocd import ArgoCDServer
from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.issuing import issue, new_authority
from robotkube.foundation.certificates.core.lives import Pair
from robotkube.foundation.forge.adapters.push_hooks import SignedPushHook
from tests.stages.handshakes import LIFE_SECONDS, server_context

TLS_HANDSHAKE = b"\x16"


class Quiet(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Clients that refuse its certificate are what some tests are for."""


class Server:
    """Tokens are valid until `expire`; requests are kept as (method, path, token). With a certificate (`tls`) it is as
    argocd-server without server.insecure: TLS at its one port, and whoever speaks clear text there is redirected."""

    def __init__(self, tls: ssl.SSLContext | None = None) -> None:
        self.requests: list[tuple[str, str, str]] = []
        self.sessions = 0
        self.tokens = 0
        self.status = 200
        self.token_page: bytes | None = None
        outer = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"
            encrypted = False

            def setup(self) -> None:
                if tls is not None and self.request.recv(1, socket.MSG_PEEK) == TLS_HANDSHAKE:
                    self.request = tls.wrap_socket(self.request, server_side=True)
                    self.encrypted = True
                super().setup()

            def finish(self) -> None:
                super().finish()
                self.request.close()

            def parse_request(self) -> bool:
                parsed = super().parse_request()
                if parsed and tls is not None and not self.encrypted:
                    self.rfile.read(int(self.headers.get("Content-Length") or 0))
                    self.send_response(307)
                    self.send_header("Location", f"https://{self.headers['Host']}{self.path}")
                    self.send_header("Content-Length", "0")
                    self.end_headers()
                    return False
                return parsed

            def do_POST(self) -> None:
                outer.sessions += 1
                body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                if outer.token_page is not None:
                    self.send_response(200)
                    self.send_header("Content-Length", str(len(outer.token_page)))
                    self.end_headers()
                    self.wfile.write(outer.token_page)
                    return
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

        self._server = Quiet(("127.0.0.1", 0), Handler)
        threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True).start()
        self.port = self._server.server_address[1]
        self.url = f"http://127.0.0.1:{self.port}"

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


Started = Callable[[Pair], Server]


@pytest.fixture
def started(tmp_path: Path) -> Iterator[Started]:
    """Starts servers that show a certificate."""
    running: list[Server] = []

    def start(pair: Pair) -> Server:
        running.append(Server(server_context(tmp_path / f"shown-{len(running)}", pair)))
        return running[-1]

    yield start
    for one in running:
        one.stop()


def connect(url: str, password: str = "word", authorities: Path | None = None) -> ArgoCDServer:  # noqa: S107
    hook = SignedPushHook(f"{url}/hook", b"x", url)
    return ArgoCDServer(url, "manager", password, hook, "robotkube-apps", authorities)


def as_argo_cd_makes_it(*names: str) -> Pair:
    """The certificate that argocd-server makes for itself: RSA, no authority, signed by its own key (util/tls)."""
    key = rsa.generate_private_key(65537, 2048)
    subject = x509.Name([x509.NameAttribute(x509.NameOID.ORGANIZATION_NAME, "Argo CD")])
    now = datetime.now(UTC)
    usage = dict.fromkeys(
        ("content_commitment", "data_encipherment", "key_agreement", "key_cert_sign", "crl_sign"), False
    ) | dict.fromkeys(("encipher_only", "decipher_only"), False)
    builder = (
        x509.CertificateBuilder(subject, subject, key.public_key(), x509.random_serial_number())
        .not_valid_before(now - timedelta(minutes=1))
        .not_valid_after(now + timedelta(days=365))
        .add_extension(x509.KeyUsage(digital_signature=True, key_encipherment=True, **usage), critical=True)
        .add_extension(x509.ExtendedKeyUsage([x509.ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.SubjectAlternativeName([x509.DNSName(name) for name in names]), critical=False)
    )
    private = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()).decode()
    return Pair(builder.sign(key, SHA256()).public_bytes(Encoding.PEM).decode(), private)


def file_of(folder: Path, *pairs: Pair) -> Path:
    """A file as the chart mounts it."""
    (folder / "ca.crt").write_text("".join(pair.certificate for pair in pairs))
    return folder / "ca.crt"


def lines(caplog: pytest.LogCaptureFixture) -> list[tuple[str, str]]:
    """What the adapter has logged, with the level."""
    name = "robotkube.delivery.manager.adapters.argocd"
    return [(one.levelname, one.getMessage()) for one in caplog.records if one.name == name]


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


def test_a_server_with_a_certificate_of_its_own_is_asked_by_https(started: Started, tmp_path: Path) -> None:
    pair = as_argo_cd_makes_it("localhost", "argocd-server", "argocd-server.argocd.svc.cluster.local")
    server = started(pair)
    argocd = connect(f"https://localhost:{server.port}", authorities=file_of(tmp_path, pair))
    assert argocd.refresh("cloud-0-bridge")
    assert argocd.refresh("cloud-0-bridge")
    assert (server.sessions, len(server.requests)) == (1, 2)
    argocd.disconnect()


@pytest.mark.parametrize("given", ["who signed it", "the certificate itself"])
def test_a_certificate_that_somebody_gave_the_server_holds(started: Started, tmp_path: Path, given: str) -> None:
    authority = new_authority("of the site", time.time())
    pair = issue(authority, ["localhost"], time.time(), LIFE_SECONDS)
    server = started(pair)
    file = file_of(tmp_path, authority if given == "who signed it" else pair)
    argocd = connect(f"https://localhost:{server.port}", authorities=file)
    assert argocd.refresh("cloud-0-bridge")
    argocd.disconnect()


def test_a_certificate_that_is_renewed_is_read_without_a_restart(started: Started, tmp_path: Path) -> None:
    old, new = (as_argo_cd_makes_it("localhost") for _ in range(2))
    server = started(new)
    file = file_of(tmp_path, old)
    argocd = connect(f"https://localhost:{server.port}", authorities=file)
    assert not argocd.refresh("cloud-0-bridge")
    file_of(tmp_path, old, new)
    assert argocd.refresh("cloud-0-bridge")
    argocd.disconnect()


@pytest.mark.parametrize("given", [False, True])
def test_a_certificate_of_others_is_refused_and_no_password_sent(
    started: Started, tmp_path: Path, caplog: pytest.LogCaptureFixture, given: bool
) -> None:
    server = started(as_argo_cd_makes_it("localhost"))
    another = file_of(tmp_path, as_argo_cd_makes_it("localhost")) if given else None
    argocd = connect(f"https://localhost:{server.port}", authorities=another)
    assert not argocd.refresh("cloud-0-bridge")
    assert server.sessions == 0
    [(level, words)] = lines(caplog)
    assert level == "WARNING"
    assert words.startswith("refresh not received application=cloud-0-bridge reason=argocd-server's certificate does")
    assert "argocd.server.authorities of the chart has to have it, or who signed it" in words
    argocd.disconnect()


def test_a_name_that_is_not_in_the_certificate_is_refused(
    started: Started, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    pair = as_argo_cd_makes_it("argocd-server.argocd.svc")
    server = started(pair)
    argocd = connect(f"https://localhost:{server.port}", authorities=file_of(tmp_path, pair))
    assert not argocd.refresh("cloud-0-bridge")
    assert "and argocd.server.url a name that stands in it" in lines(caplog)[0][1]
    argocd.disconnect()


def test_a_redirect_to_https_is_said_once_and_not_followed(
    started: Started, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    server = started(as_argo_cd_makes_it("localhost"))
    argocd = connect(f"http://localhost:{server.port}")
    for name in ("cloud-0-bridge", "cloud-0-recorder", "vehicle-00-bridge"):
        assert not argocd.refresh(name)
    assert (server.sessions, server.requests) == (0, [])
    [(level, words)] = lines(caplog)
    assert level == "ERROR"
    address = f"localhost:{server.port}"
    assert words.startswith(f"refresh redirected url=http://{address} to=https://{address}/api/v1/session fix=give ")
    assert "argocd.server.authorities" in words
    assert 'server.insecure: "true"' in words
    argocd.disconnect()


def test_a_redirect_is_said_again_when_the_server_has_answered_meanwhile(
    server: Server, caplog: pytest.LogCaptureFixture
) -> None:
    argocd = connect(server.url)
    argocd._say_redirected("https://argocd.example/")
    assert argocd.refresh("cloud-0-bridge")
    argocd._say_redirected("https://argocd.example/")
    assert len(lines(caplog)) == 2
    argocd.disconnect()


def test_a_server_that_speaks_no_tls(server: Server, caplog: pytest.LogCaptureFixture) -> None:
    argocd = connect(f"https://127.0.0.1:{server.port}")
    assert not argocd.refresh("cloud-0-bridge")
    assert "argocd-server speaks no TLS there: leave argocd.server of the chart empty" in lines(caplog)[0][1]
    argocd.disconnect()


@pytest.mark.parametrize("page", [b"<html>", b"[]", b"{}"])
def test_what_is_no_argocd_server(server: Server, caplog: pytest.LogCaptureFixture, page: bytes) -> None:
    """As an ingress with a page of its own, at an address that somebody gave."""
    server.token_page = page
    argocd = connect(server.url)
    assert not argocd.refresh("cloud-0-bridge")
    assert "answers without a token, so it is not argocd-server; name the address" in lines(caplog)[0][1]
    argocd.disconnect()


@pytest.mark.parametrize("text", ["", "no certificate", None])
def test_a_file_without_a_certificate_is_refused_at_the_start(tmp_path: Path, text: str | None) -> None:
    if text is not None:
        (tmp_path / "ca.crt").write_text(text)
    with pytest.raises(InputError, match=r"argocd.authorities: .*ca.crt has no certificate that can be read"):
        connect("https://localhost:1", authorities=tmp_path / "ca.crt")
