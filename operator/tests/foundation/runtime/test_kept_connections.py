"""Requests on connections that the server has ended meanwhile, with answers in memory."""

from __future__ import annotations

import httpx
import pytest

from robotkube.foundation.runtime.adapters.kept_connections import KeptConnections


def client(faults: list[Exception], heard: list[str]) -> KeptConnections:
    """Its server ends that many connections before it answers."""

    def answer(request: httpx.Request) -> httpx.Response:
        heard.append(request.method)
        if faults:
            raise faults.pop()
        return httpx.Response(200, text="yes")

    return KeptConnections(transport=httpx.MockTransport(answer))


@pytest.mark.parametrize("fault", [httpx.RemoteProtocolError, httpx.ReadError, httpx.WriteError])
def test_what_reads_is_asked_once_more(fault: type[httpx.TransportError]) -> None:
    heard: list[str] = []
    with client([fault("ended")], heard) as asking:
        assert asking.get("https://forge.example/").text == "yes"
    assert heard == ["GET", "GET"]
    with client([fault("ended"), fault("ended")], heard) as asking, pytest.raises(fault):
        asking.head("https://forge.example/")


def test_what_changes_something_is_sent_once() -> None:
    heard: list[str] = []
    with client([httpx.RemoteProtocolError("ended")], heard) as asking, pytest.raises(httpx.RemoteProtocolError):
        asking.post("https://forge.example/")
    assert heard == ["POST"]


def test_who_does_not_answer_at_all_is_not_asked_again() -> None:
    heard: list[str] = []
    with client([httpx.ConnectError("away")], heard) as asking, pytest.raises(httpx.ConnectError):
        asking.get("https://forge.example/")
    assert heard == ["GET"]
