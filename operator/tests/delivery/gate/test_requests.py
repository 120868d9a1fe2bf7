"""What the gate answers to requests of any form, wired as its process wires it: never a dropped connection."""

import base64
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.delivery.gate.__main__ import (
    OBJECTS_PATH,
    build_gate,
    build_notes,
    build_publication,
    build_server,
    read_configuration,
)
from robotkube.foundation.forge.core.commit_objects import object_id
from robotkube.foundation.runtime.core.webhook_deliveries import sign
from robotkube.foundation.runtime.settings_file import read_settings
from robotkube.registry.catalogue.adapters.bounded_validation import BoundedSchemas
from robotkube.registry.charts.adapters.chart_renderer import ChartRenderer
from tests.stages import http_calls
from tests.stages.attacks import shown
from tests.stages.delivery.gate.gate_settings import OCI_REGISTRY, settings_file
from tests.stages.random_json import mistaken
from tests.stages.registry.signed_evidence import signing_key

EVENTS = ("push", "pull_request", "pull_request_comment", "pull_request_approved", "issues", "")
PULL_REQUEST = {"number": 7, "user": {"login": "manager"}, "head": {"sha": "f" * 40}, "merged": False}
COMMIT = b"tree 0\n\nnothing\n"
OBJECTS = {
    "repository": "robotkube/deployment",
    "commit": object_id("commit", COMMIT),
    "objects": [{"kind": "commit", "content": base64.b64encode(COMMIT).decode()}],
}


def delivery(repository: str, action: str) -> dict[str, Any]:
    return {
        "action": action,
        "ref": "refs/heads/main",
        "after": "0" * 40,
        "repository": {"full_name": repository},
        "pull_request": PULL_REQUEST,
        "issue": {"number": 7},
    }


DELIVERIES = [
    delivery("robotkube/deployment", "opened"),
    delivery("robotkube/deployment", "created"),
    delivery("robotkube/catalogue", "synchronized"),
]


class Sender:
    """Who signs requests to the gate with the secrets of its settings."""

    def __init__(self, url: str, folder: Path) -> None:
        self._client = http_calls.client(base_url=url)
        self._folder = folder

    def deliver(self, body: bytes, event: str = "push") -> httpx.Response:
        return self._post("/webhook", body, "webhook", event)

    def page(self, path: str) -> httpx.Response:
        return self._client.get(path)

    def send_objects(self, body: bytes) -> httpx.Response:
        return self._post(f"{OBJECTS_PATH}/manager", body, "proposer")

    def _post(self, path: str, body: bytes, secret: str, event: str = "") -> httpx.Response:
        signature = sign(body, (self._folder / secret).read_bytes())
        return self._client.post(path, content=body, headers={"X-Gitea-Event": event, "X-Gitea-Signature": signature})

    def close(self) -> None:
        self._client.close()


@pytest.fixture(scope="module")
def sender(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sender]:
    folder = tmp_path_factory.mktemp("gate")
    signing_key(folder)
    (folder / "keys").mkdir()
    listen = {"address": "127.0.0.1", "port": 0}
    configuration = read_settings(settings_file(folder, oci_registry=OCI_REGISTRY, listen=listen), read_configuration)
    schemas = BoundedSchemas()
    renderer = ChartRenderer("never started")
    gate = build_gate(configuration, folder / "work", schemas, renderer)
    publication = build_publication(configuration, folder / "work", gate, schemas, renderer)
    server = build_server(configuration, gate, publication, build_notes(configuration, folder / "work"))
    server.start()
    connected = Sender(f"http://127.0.0.1:{server.port}", folder)
    yield connected
    connected.close()
    server.stop()
    schemas.close()


def test_what_is_right_is_received(sender: Sender) -> None:
    for document in DELIVERIES:
        for event in EVENTS:
            assert sender.deliver(json.dumps(document).encode(), event).status_code == 204
    assert sender.send_objects(json.dumps(OBJECTS).encode()).status_code == 200


def test_who_asks_is_told_what_was_decided(sender: Sender) -> None:
    assert sender.page("/decisions").json() == {"decisions": []}
    assert sender.page("/unchecked").json() == {"tip": "", "problem": "", "commits": []}


@given(st.one_of(map(mistaken, DELIVERIES)), st.sampled_from(EVENTS))
def test_any_delivery_is_received_or_refused(sender: Sender, document: Any, event: str) -> None:
    answer = sender.deliver(json.dumps(document).encode(), event)
    assert answer.status_code in (204, 400)
    assert answer.text or answer.status_code == 204


@given(mistaken(OBJECTS))
def test_any_objects_are_received_or_refused(sender: Sender, document: Any) -> None:
    answer = sender.send_objects(json.dumps(document).encode())
    assert answer.status_code in (200, 400)
    assert answer.json() == {} if answer.status_code == 200 else answer.json()["problems"]


@pytest.mark.parametrize("body", [b"[" * 100_000, b"[" * 101 + b"]" * 101, b"{", b"", b"\xff"])
def test_what_is_deep_or_no_json_is_refused_with_words(sender: Sender, body: bytes) -> None:
    for answer in (sender.deliver(body), sender.send_objects(body)):
        assert answer.status_code == 400
        shown("gate", answer.text, "deep-json")
