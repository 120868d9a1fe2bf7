"""The HTTP side of a process by HTTPS: who speaks HTTP is told so, a renewed certificate is shown without a restart and
without a lost request, and the bounds on clients hold as they do in clear text."""

from __future__ import annotations

import json
import logging
import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import pytest

from robotkube.errors import DocumentError, InputError
from robotkube.foundation.certificates.adapters.issuing import issue, new_authority
from robotkube.foundation.certificates.core.lives import Pair
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.runtime import settings_file
from robotkube.foundation.runtime.adapters.bounded_connections import CONNECTIONS_OF_SOURCE_MAX, ConnectionBounds
from robotkube.foundation.runtime.adapters.webhook_server import WebServer
from robotkube.foundation.runtime.core.webhook_deliveries import WebhookDelivery, sign
from tests.stages import http_calls
from tests.stages.waiting import until

NAME, HERE = "localhost", "127.0.0.1"
SECRET = b"shared"
RENEWALS = 5
LIVE = b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n"


@dataclass
class Served:
    """A server with the certificate in `folder`, and its authority."""

    folder: Path
    bounds: ConnectionBounds = field(default_factory=ConnectionBounds)
    heard: list[WebhookDelivery] = field(default_factory=list)
    authority: Pair = field(default_factory=lambda: new_authority("ours", time.time()))

    def start(self) -> None:
        self.show(issue(self.authority, [NAME], time.time(), 3600))
        self.server = WebServer(
            *(HERE, 0, list, lambda: "things 1\n", SECRET, self.heard.append),
            health_port=0,
            certificate=self.folder,
            bounds=self.bounds,
        )
        self.server.start()

    @property
    def url(self) -> str:
        return f"https://{NAME}:{self.server.port}"

    def show(self, pair: Pair) -> None:
        """Another certificate in the mounted files, one after the other: a kubelet changes both at once."""
        for name, text in (("tls.key", pair.key), ("tls.crt", pair.certificate)):
            (self.folder / f"{name}.new").write_text(text)
            (self.folder / f"{name}.new").replace(self.folder / name)

    def context(self) -> ssl.SSLContext:
        """A client's that believes its authority alone."""
        return ssl.create_default_context(cadata=self.authority.certificate)

    def shown(self) -> bytes:
        """The certificate that a new connection gets."""
        with (
            socket.create_connection((HERE, self.server.port), 10) as plain,
            self.context().wrap_socket(plain, server_hostname=NAME) as encrypted,
        ):
            return encrypted.getpeercert(binary_form=True) or b""

    def deliver(self, client: httpx.Client) -> int:
        body = json.dumps({"after": "x"}).encode()
        headers = {"X-Gitea-Event": "push", "X-Gitea-Signature": sign(body, SECRET)}
        return client.post(f"{self.url}/webhook", content=body, headers=headers).status_code


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Served]]:
    started = []

    def begin(**bounds: float) -> Served:
        served = Served(tmp_path, ConnectionBounds(**bounds))  # type: ignore[arg-type]
        served.start()
        started.append(served)
        return served

    yield begin
    for served in started:
        served.server.stop()


def test_deliveries_by_https_and_health_by_http(start: Callable[..., Served]) -> None:
    served = start()
    with httpx.Client(verify=served.context()) as client:
        assert served.deliver(client) == 204
        assert client.get(f"{served.url}/livez").status_code == 200
    assert served.heard == [WebhookDelivery("push", {"after": "x"})]
    assert http_calls.get(f"http://{HERE}:{served.server.ports['health_port']}/metrics").text == "things 1\n"


def test_who_speaks_http_is_told_so(start: Callable[..., Served]) -> None:
    served = start()
    answer = http_calls.post(f"http://{NAME}:{served.server.port}/webhook", content=b"{}")
    assert answer.status_code == 400
    assert answer.json() == {"message": "this port speaks HTTPS; ask by an address that begins with https://"}
    assert served.heard == []


def test_versions_before_tls_1_2_are_refused(start: Callable[..., Served]) -> None:
    served = start()
    old = served.context()
    with pytest.warns(DeprecationWarning, match="TLSv1_1"):
        old.minimum_version, old.maximum_version = ssl.TLSVersion.TLSv1_1, ssl.TLSVersion.TLSv1_1
    old.set_ciphers("ALL:@SECLEVEL=0")
    with socket.create_connection((HERE, served.server.port), 10) as plain, pytest.raises(ssl.SSLError):
        old.wrap_socket(plain, server_hostname=NAME)


def test_a_renewal_loses_no_delivery_on_kept_and_on_new_connections(start: Callable[..., Served]) -> None:
    served = start()
    ended = threading.Event()
    lost: list[object] = []
    answered = {"kept": 0, "new": 0}

    def ask(kind: str) -> None:
        kept = httpx.Client(verify=served.context())
        while not ended.is_set():
            client = kept if kind == "kept" else httpx.Client(verify=served.context())
            try:
                if served.deliver(client) != 204:
                    lost.append(kind)
            except httpx.HTTPError as error:
                lost.append(repr(error))
            answered[kind] += 1
            if client is not kept:
                client.close()
        kept.close()

    threads = [threading.Thread(target=ask, args=(kind,)) for kind in answered]
    for thread in threads:
        thread.start()
    seen = {served.shown()}
    for _ in range(RENEWALS):
        served.show(issue(served.authority, [NAME], time.time(), 3600))
        seen.add(served.shown())
        before = dict(answered)
        until(lambda before=before: all(answered[kind] > before[kind] for kind in answered), "further answers")
    ended.set()
    for thread in threads:
        thread.join()
    assert lost == []
    assert len(served.heard) == sum(answered.values())
    assert len(seen) == 1 + RENEWALS


def test_while_certificate_and_key_do_not_belong_together_the_last_pair_stays(
    start: Callable[..., Served], caplog: pytest.LogCaptureFixture
) -> None:
    served = start()
    before = served.shown()
    renewed = issue(served.authority, [NAME], time.time(), 3600)
    with caplog.at_level(logging.INFO, "robotkube"):
        (served.folder / "tls.crt").write_text(renewed.certificate)
        assert [served.shown(), served.shown()] == [before, before]
        [line] = [record.getMessage() for record in caplog.records]
        assert line.startswith(f"certificate not renewed folder={served.folder} reason=")
        served.show(renewed)
        assert served.shown() != before
    assert caplog.records[-1].getMessage() == f"certificate renewed folder={served.folder}"


def test_without_a_certificate_it_does_not_start(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"tls\.crt and tls\.key are no certificate with its key .* the pod mounts"):
        WebServer(HERE, 0, list, str, certificate=tmp_path)


def test_a_client_that_does_not_greet_keeps_nobody_waiting_and_is_ended(start: Callable[..., Served]) -> None:
    served = start(head_seconds=0.2)
    with socket.create_connection((HERE, served.server.port), 10) as silent:
        assert served.shown()
        assert silent.recv(100) == b""


def taken(served: Served) -> bool:
    """Return whether a new connection is taken; the place of one that was ended is free a moment later."""
    try:
        return bool(served.shown())
    except (ssl.SSLError, ConnectionError):
        return False


def test_a_source_beyond_its_bound_loses_its_oldest_connection(start: Callable[..., Served]) -> None:
    """And what it sends there afterwards in clear text is no request."""
    served = start()
    held = [socket.create_connection((HERE, served.server.port), 10) for _ in range(CONNECTIONS_OF_SOURCE_MAX)]
    encrypted = [served.context().wrap_socket(one, server_hostname=NAME) for one in held]
    try:
        for one in encrypted:
            one.sendall(LIVE)
            assert one.recv(200).startswith(b"HTTP/1.1 200")
        with socket.create_connection((HERE, served.server.port), 10) as refused:
            assert refused.recv(100) == b""
        oldest = encrypted[0]
        while oldest.recv(4096):  # what was left of the first answer
            continue
        until(lambda: taken(served), "the place of the one that was ended")
    finally:
        for one in encrypted:
            one.close()


def test_only_a_process_that_serves_by_https_takes_a_certificate() -> None:
    given = {"address": "0.0.0.0", "port": 8080, "certificate": "/var/run/secrets/robotkube/certificate"}  # noqa: S104
    reader = Reader("settings")
    assert settings_file.listen(reader, given, encrypts=True).certificate == Path(given["certificate"])  # type: ignore[arg-type]
    assert reader.problems == []
    settings_file.listen(reader, given)
    with pytest.raises(DocumentError, match=r"listen\.certificate: unknown key"):
        reader.finish()
