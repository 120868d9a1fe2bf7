"""Requests of one process of the platform to another by HTTPS: each client believes the platform's authority and no
other, and none of them gets anywhere in clear text."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.manager.adapters.leader_proxy import LeaderRequests
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.adapters import certificate_authorities
from robotkube.foundation.certificates.adapters.issuing import new_authority
from robotkube.foundation.certificates.core.lives import Pair
from robotkube.foundation.forge.adapters.push_hooks import ObjectsRelay, PushRelay
from robotkube.foundation.forge.core.commit_objects import CommitObjects
from robotkube.foundation.pages.adapters.http_pages import HttpPages
from robotkube.foundation.runtime.adapters.webhook_server import Signed, WebServer
from robotkube.foundation.runtime.core.webhook_deliveries import WebhookDelivery
from robotkube.registry.suites.adapters.runner_protocol import RunsEndpoint, SuiteRunnerClient
from robotkube.registry.suites.core.requests import SuiteProgress, SuiteRequest
from robotkube.testing.leadership import MemoryLeadership
from robotkube.testing.suites import make_request, passed
from tests.stages.handshakes import certified, written
from tests.stages.waiting import until

NAME, SERVICE = "localhost", "manager.robotkube.svc.cluster.local"
SECRET = b"shared"
TOKEN = "shared word"  # noqa: S105 - of this test alone
REPOSITORY = "robotkube/deployment"


@dataclass
class Peer:
    """One process that is asked, with all that any of them answers; its Service has two names, its pod an address."""

    folder: Path
    asked: list[str] = field(default_factory=list)
    authority: Pair = field(default_factory=lambda: new_authority("ours", time.time()))

    def start(self) -> None:
        runs = RunsEndpoint(TOKEN, self._run)
        self.server = WebServer(
            *("127.0.0.1", 0, list, str, SECRET, self._deliver, {"/plans": self._plans}, runs.put),
            signed={"/objects/manager": Signed(SECRET, self._objects)},
            certificate=certified(self.folder, self.authority, SERVICE, NAME),
        )
        self.server.start()

    def _deliver(self, delivery: WebhookDelivery) -> None:
        self.asked.append(delivery.event)

    def _plans(self) -> Mapping[str, Any]:
        self.asked.append("plans")
        return {}

    def _run(self, request: SuiteRequest) -> SuiteProgress:
        self.asked.append("run")
        return SuiteProgress("finished", passed(request))

    def _objects(self, body: bytes) -> tuple[int, Mapping[str, Any]]:
        self.asked.append("objects")
        return 200, {}

    def url(self, scheme: str) -> str:
        return f"{scheme}://{NAME}:{self.server.port}"


@pytest.fixture
def peer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Peer]:
    monkeypatch.setattr(certificate_authorities, "_trusted", {})
    started = Peer(tmp_path / "peer")
    started.start()
    yield started
    started.server.stop()


@contextmanager
def gate_wakes_manager(peer: Peer, scheme: str) -> Iterator[None]:
    relay = PushRelay(f"{peer.url(scheme)}/webhook", SECRET, REPOSITORY)
    relay.hook("0", "1")
    yield
    relay.disconnect()


@contextmanager
def manager_hands_objects_to_gate(peer: Peer, scheme: str) -> Iterator[None]:
    relay = ObjectsRelay(f"{peer.url(scheme)}/objects/manager", SECRET, REPOSITORY)
    relay.send(CommitObjects("a" * 40, ()))
    yield
    relay.disconnect()


@contextmanager
def gate_asks_suite_runner(peer: Peer, scheme: str) -> Iterator[None]:
    client = SuiteRunnerClient(peer.url(scheme), TOKEN)
    try:
        client.run(make_request())
        yield
    finally:
        client.disconnect()


@contextmanager
def console_reads_manager(peer: Peer, scheme: str) -> Iterator[None]:
    pages = HttpPages()
    try:
        pages.get(f"{peer.url(scheme)}/plans")
        yield
    finally:
        pages.close()


@contextmanager
def manager_asks_its_leader(peer: Peer, scheme: str) -> Iterator[None]:
    """By the address of its pod, which no certificate has."""
    leadership = MemoryLeadership(None, f"127.0.0.1:{peer.server.port}")
    requests = LeaderRequests(leadership, server_name=SERVICE if scheme == "https" else "")
    answer = requests("GET", "/plans", {}, b"")
    requests.close()
    assert answer is not None
    if answer[0] != 200:
        raise UnavailableError(answer[1])
    yield


CLIENTS = (
    gate_wakes_manager,
    manager_hands_objects_to_gate,
    gate_asks_suite_runner,
    console_reads_manager,
    manager_asks_its_leader,
)
Client = Callable[[Peer, str], AbstractContextManager[None]]


def refusal(peer: Peer, client: Client, scheme: str, caplog: pytest.LogCaptureFixture) -> str:
    """What a client says who got nowhere, as an error or in its log; empty when it was answered."""
    try:
        with client(peer, scheme):
            until(lambda: peer.asked or caplog.messages, "what became of the request")
    except (InputError, UnavailableError) as error:
        return str(error)
    return " ".join(caplog.messages)


@pytest.mark.parametrize("client", CLIENTS)
def test_it_is_answered_by_whom_the_platforms_authority_signed_for(
    peer: Peer, client: Client, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    certificate_authorities.trust(written(tmp_path, peer.authority))
    assert refusal(peer, client, "https", caplog) == ""
    assert len(peer.asked) == 1


@pytest.mark.parametrize("client", CLIENTS)
def test_a_certificate_of_another_authority_is_refused_in_words(
    peer: Peer, client: Client, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = written(tmp_path, new_authority("another", time.time()))
    certificate_authorities.trust(file)
    words = f"its certificate is of an authority that {file} does not have; compare that file with ConfigMap"
    assert words in refusal(peer, client, "https", caplog)
    assert peer.asked == []


@pytest.mark.parametrize("client", CLIENTS)
def test_in_clear_text_it_gets_nowhere(peer: Peer, client: Client, caplog: pytest.LogCaptureFixture) -> None:
    assert "this port speaks HTTPS" in refusal(peer, client, "http", caplog)
    assert peer.asked == []
