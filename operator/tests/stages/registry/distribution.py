"""An OCI registry as others run it: distribution, by HTTPS with a certificate of an authority of its own. It takes
tokens and nothing else, which something beside it gives to one account; or it is open to everybody."""

from __future__ import annotations

import base64
import json
import subprocess
import threading
import time
import urllib.parse
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import yaml
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import decode_dss_signature
from cryptography.hazmat.primitives.hashes import SHA256

from ci.cluster.embedded.network.namespaces import inside
from robotkube.foundation.certificates.adapters.issuing import issue, new_authority
from tests.stages import waiting
from tests.stages.handshakes import certified, server_context, written
from tests.stages.programs import free_port

USER, PASSWORD = "robot", "its-password"
SERVICE, ISSUER = "registry", "tests"
SECONDS = 300
LOOPBACK = "127.0.0.1"
COORDINATE_BYTES = 32
END_SECONDS_MAX = 20
OWN_NAMESPACE = Path("/proc/self/ns/net")


def _plain(data: bytes) -> str:
    return base64.urlsafe_b64encode(data).rstrip(b"=").decode()


@dataclass
class Tokens:
    """Gives tokens signed with a key of its own; `given` are the scopes that were asked for."""

    key: ec.EllipticCurvePrivateKey = field(default_factory=lambda: ec.generate_private_key(ec.SECP256R1()))
    given: list[str] = field(default_factory=list)

    def public(self) -> dict[str, Any]:
        """The key by which its tokens are believed, as a set of JSON Web Keys."""
        numbers = self.key.public_key().public_numbers()
        x, y = (_plain(number.to_bytes(COORDINATE_BYTES, "big")) for number in (numbers.x, numbers.y))
        return {"keys": [{"kty": "EC", "crv": "P-256", "use": "sig", "alg": "ES256", "kid": "tests", "x": x, "y": y}]}

    def token(self, scopes: list[str]) -> str:
        """A token for these scopes."""
        self.given += scopes
        parts = [scope.split(":") for scope in scopes]
        access = [{"type": kind, "name": name, "actions": actions.split(",")} for kind, name, actions in parts]
        now = int(time.time())
        claims = {"iss": ISSUER, "sub": USER, "aud": SERVICE, "exp": now + SECONDS, "nbf": now - 10, "iat": now}
        signed = ".".join(
            _plain(json.dumps(one).encode())
            for one in ({"typ": "JWT", "alg": "ES256", "kid": "tests"}, {**claims, "jti": "1", "access": access})
        )
        r, s = decode_dss_signature(self.key.sign(signed.encode(), ec.ECDSA(SHA256())))
        return f"{signed}.{_plain(r.to_bytes(COORDINATE_BYTES, 'big') + s.to_bytes(COORDINATE_BYTES, 'big'))}"


@dataclass(frozen=True)
class Distribution:
    """One that runs: its host with port, the file of its authority, and who gives tokens for it."""

    host: str
    authority: Path
    tokens: Tokens
    log: Path


@contextmanager
def running(program: Path, folder: Path) -> Iterator[Distribution]:
    """The registry with its data below `folder`, and what gives tokens; both are ended afterwards."""
    authority = new_authority("registry", time.time())
    context = server_context(folder / "tls", issue(authority, [LOOPBACK], time.time(), 3600))
    tokens = Tokens()
    server = ThreadingHTTPServer((LOOPBACK, 0), type("Handler", (_Handler,), {"tokens": tokens}))
    server.socket = context.wrap_socket(server.socket, server_side=True)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    try:
        server_of_tokens = _taking_tokens(folder, tokens, f"https://{LOOPBACK}:{server.server_port}/token")
        with _process(program, folder, LOOPBACK, {"auth": server_of_tokens}) as host:
            yield Distribution(host, written(folder / "ca", authority), tokens, folder / "log")
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@contextmanager
def open_to_all(program: Path, folder: Path, address: str, namespace: Path = OWN_NAMESPACE) -> Iterator[Distribution]:
    """The registry at an address of this machine, or of another network namespace on it, without accounts."""
    authority = new_authority("registry", time.time())
    certified(folder / "tls", authority, address)
    with _process(program, folder, address, {}, namespace) as host:
        yield Distribution(host, written(folder / "ca", authority), Tokens(), folder / "log")


def _taking_tokens(folder: Path, tokens: Tokens, realm: str) -> dict[str, Any]:
    (folder / "keys.json").write_text(json.dumps(tokens.public()), encoding="utf-8")
    jwks = str(folder / "keys.json")
    names = {"realm": realm, "service": SERVICE, "issuer": ISSUER}
    return {"token": {**names, "jwks": jwks, "signingalgorithms": ["ES256"]}}


@contextmanager
def _process(
    program: Path, folder: Path, address: str, access: Mapping[str, Any], namespace: Path = OWN_NAMESPACE
) -> Iterator[str]:
    host = f"{address}:{free_port()}"
    settings = {
        "version": "0.1",
        "log": {"level": "info"},
        "storage": {"filesystem": {"rootdirectory": str(folder / "data")}, "delete": {"enabled": True}},
        "http": {
            "addr": host,
            "secret": "of-this-test",
            "tls": {"certificate": str(folder / "tls" / "tls.crt"), "key": str(folder / "tls" / "tls.key")},
        },
        **access,
    }
    (folder / "registry.yaml").write_text(yaml.safe_dump(settings), encoding="utf-8")
    with (folder / "log").open("w") as log:
        entered = [] if namespace == OWN_NAMESPACE else ["nsenter", f"--net={namespace}"]
        command = [*entered, str(program), "serve", str(folder / "registry.yaml")]
        process = subprocess.Popen(command, stdout=log, stderr=log)
        try:
            waiting.until(lambda: process.poll() is not None or _answers(host, namespace), "registry", seconds=60)
            assert process.poll() is None, (folder / "log").read_text()[-2000:]
            yield host
        finally:
            process.terminate()
            try:
                process.wait(END_SECONDS_MAX)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _answers(host: str, namespace: Path) -> bool:
    def answers() -> bool:
        try:
            return httpx.get(f"https://{host}/v2/", verify=False, trust_env=False, timeout=5).status_code in (200, 401)  # noqa: S501
        except httpx.TransportError:
            return False

    return answers() if namespace == OWN_NAMESPACE else inside(namespace, answers)


class _Handler(BaseHTTPRequestHandler):
    tokens: Tokens

    def do_GET(self) -> None:
        account = base64.b64encode(f"{USER}:{PASSWORD}".encode()).decode()
        known = self.headers.get("Authorization") == f"Basic {account}"
        scopes = urllib.parse.parse_qs(urllib.parse.urlsplit(self.path).query).get("scope", [])
        body = json.dumps({"token": self.tokens.token(scopes), "expires_in": SECONDS} if known else {}).encode()
        self.send_response(200 if known else 401)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        pass
