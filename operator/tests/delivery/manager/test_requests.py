"""What the manager answers to requests of any form, wired as its process wires it: never a dropped connection."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.delivery.manager.__main__ import build_server, read_configuration
from robotkube.delivery.manager.telemetry import ManagerTelemetry
from robotkube.foundation.runtime.core.webhook_deliveries import sign
from robotkube.foundation.runtime.settings_file import read_settings
from robotkube.testing.clusters import MemoryTasks
from tests.stages import http_calls
from tests.stages.delivery.manager.manager_in_memory import Stage
from tests.stages.delivery.manager.manager_process import Outside, write_settings
from tests.stages.random_json import mistaken

SECRET = b"webhook secret"
NOWHERE = "http://nowhere.example"
OUTSIDE = Outside(NOWHERE, "password", SECRET.decode(), Path("/etc/robotkube/keys"), "oci://nowhere.example/x", NOWHERE)
DELIVERY = {
    "action": "closed",
    "ref": "refs/heads/main",
    "after": "0" * 40,
    "repository": {"full_name": "robotkube/deployment"},
    "pull_request": {"number": 7, "merged": False},
}
TASK = {
    "apiVersion": "robotkube.io/v1alpha1",
    "kind": "TaskDescription",
    "metadata": {
        "namespace": "cloud-0",
        "name": "new",
        "uid": "1",
        "generation": 1,
        "creationTimestamp": "2026-11-21T10:00:00Z",
        "annotations": {"robotkube.io/agents": "vehicle-00"},
    },
    "spec": {
        "requester": "somebody",
        "event": {"rule": "asked", "id": "x", "trace": "b" * 32, "time": "2026-11-21T10:00:00Z"},
        "application": "pose-point-cloud-recording",
        "parameters": {"vehicles": ["vehicle-00", "vehicle-01"]},
        "priority": 5,
        "lease": {"seconds": 60},
    },
}


class SeenTasks(MemoryTasks):
    """The cluster as far as the web server asks it."""

    def complaints(self) -> Sequence[str]:
        return []


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    folder = tmp_path_factory.mktemp("manager")
    stage = Stage(folder / "stage")
    listen = {"address": "127.0.0.1", "port": 0}
    path = write_settings(OUTSIDE, folder / "settings", 0, "lease", listen=listen)
    configuration = read_settings(path, read_configuration)
    tasks: Any = SeenTasks()
    leads: Any = lambda *request: None  # noqa: E731
    telemetry = ManagerTelemetry(stage.manager, stage.tasks, stage.cluster, lambda: [], "", "manager")
    server = build_server(configuration, stage.manager, tasks, None, telemetry, leads)
    server.start()
    with http_calls.client(base_url=f"http://127.0.0.1:{server.port}", timeout=30) as connected:
        yield connected
    server.stop()


def deliver(client: httpx.Client, body: bytes, event: str = "push") -> httpx.Response:
    headers = {"X-Gitea-Event": event, "X-Gitea-Signature": sign(body, SECRET)}
    return client.post("/webhook", content=body, headers=headers)


def test_what_is_right_is_answered(client: httpx.Client) -> None:
    for event in ("push", "pull_request"):
        assert deliver(client, json.dumps(DELIVERY).encode(), event).status_code == 204
    assert client.post("/explain", json=TASK).status_code == 200
    assert client.post("/explain", json={"task": "cloud-0/nothing"}).status_code == 404


@given(mistaken(DELIVERY), st.sampled_from(["push", "pull_request", ""]))
def test_any_delivery_is_received_or_refused(client: httpx.Client, document: Any, event: str) -> None:
    assert deliver(client, json.dumps(document).encode(), event).status_code in (204, 400)


@given(mistaken(TASK) | mistaken({"task": "cloud-0/nothing"}))
def test_any_question_is_answered_or_refused(client: httpx.Client, document: Any) -> None:
    answer = client.post("/explain", content=json.dumps(document).encode())
    assert answer.status_code in (200, 400, 404)
    assert answer.json()["message"] or answer.status_code == 200


@pytest.mark.parametrize("body", [b"[" * 100_000, b"[" * 101 + b"]" * 101, b"{", b"", b"\xff"])
def test_what_is_deep_or_no_json_is_refused_with_words(client: httpx.Client, body: bytes) -> None:
    assert deliver(client, body).status_code == 400
    answer = client.post("/explain", content=body)
    assert (answer.status_code, answer.json()["message"].startswith("no JSON: ")) == (400, True)
