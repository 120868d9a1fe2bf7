"""Requests on connections that the server has ended meanwhile, with answers in memory."""

from __future__ import annotations

import ssl

import httpx
import pytest

from robotkube.foundation.runtime.adapters import asking_again
from robotkube.foundation.runtime.adapters.kept_connections import KeptConnections


def client(faults: list[Exception], heard: list[str]) -> KeptConnections:
    """Its server ends that many connections before it answers."""

    def answer(request: httpx.Request) -> httpx.Response:
        heard.append(request.method)
        if faults:
            raise faults.pop()
        return httpx.Response(200, text="yes")

    return KeptConnections(transport=httpx.MockTransport(answer))


def caused(error: httpx.TransportError, cause: OSError) -> httpx.TransportError:
    error.__cause__ = cause
    return error


RESET = ConnectionResetError(104, "Connection reset by peer")
ENDED = [
    caused(httpx.ConnectError("ended"), RESET),
    caused(httpx.ConnectError("ended"), ssl.SSLEOFError()),
    caused(httpx.ConnectError("ended"), ssl.SSLZeroReturnError()),
]
AWAY = [
    httpx.ConnectError("no route"),
    caused(httpx.ConnectError("refused"), ConnectionRefusedError()),
    caused(httpx.ConnectError("another name"), ssl.SSLCertVerificationError()),
    httpx.ConnectTimeout("silent"),
    httpx.ReadTimeout("silent"),
]
SENT = [httpx.RemoteProtocolError("ended"), httpx.ReadError("ended"), httpx.WriteError("ended")]


@pytest.fixture(autouse=True)
def pauses(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    paused: list[float] = []
    monkeypatch.setattr(asking_again.time, "sleep", paused.append)
    return paused


@pytest.mark.parametrize("fault", [*SENT, *ENDED])
def test_what_reads_is_asked_again(fault: httpx.TransportError, pauses: list[float]) -> None:
    heard: list[str] = []
    with client([fault, fault], heard) as asking:
        assert asking.get("https://forge.example/").text == "yes"
    assert heard == ["GET"] * 3
    assert len(set(pauses)) == 2
    with client([fault] * 3, heard) as asking, pytest.raises(type(fault)):
        asking.head("https://forge.example/")
    assert heard == ["GET"] * 3 + ["HEAD"] * 3


@pytest.mark.parametrize("fault", SENT)
def test_what_changes_something_is_sent_once(fault: httpx.TransportError) -> None:
    heard: list[str] = []
    with client([fault], heard) as asking, pytest.raises(type(fault)):
        asking.post("https://forge.example/")
    assert heard == ["POST"]


@pytest.mark.parametrize("fault", ENDED)
def test_what_was_not_sent_is_sent_again(fault: httpx.TransportError) -> None:
    heard: list[str] = []
    with client([fault], heard) as asking:
        assert asking.post("https://forge.example/").text == "yes"
    assert heard == ["POST"] * 2


@pytest.mark.parametrize("fault", AWAY)
def test_who_does_not_answer_at_all_is_not_asked_again(fault: httpx.TransportError) -> None:
    heard: list[str] = []
    with client([fault], heard) as asking, pytest.raises(type(fault)):
        asking.get("https://forge.example/")
    assert heard == ["GET"]
