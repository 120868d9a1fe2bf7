"""The suite-runner's protocol over real sockets, and its process: token, key, bounds, results, the end."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from hypothesis import given

from robotkube.errors import DocumentError, InputError, UnavailableError
from robotkube.foundation.runtime.adapters.webhook_server import BODY_BYTES_MAX, WebServer
from robotkube.foundation.runtime.settings_file import read_settings, warn_of_former_keys
from robotkube.registry.suites.__main__ import needs_namespace
from robotkube.registry.suites.adapters.runner_protocol import REQUEST_BYTES_MAX, RunsEndpoint, SuiteRunnerClient
from robotkube.registry.suites.core.requests import SuiteProgress, SuiteRequest, request_document
from robotkube.registry.suites.loops.queue import SuiteQueue
from robotkube.registry.suites.loops.static import StaticSuite
from robotkube.registry.suites.settings import FORMER_KEYS, read_configuration
from robotkube.testing.suites import MemoryExecutor, make_request, passed
from tests.stages import http_calls
from tests.stages.random_json import mistaken
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

TOKEN = "shared word"  # noqa: S105 - of the tests
START_SECONDS_MAX = 60.0


class Runner:
    def __init__(self, put: Callable[[SuiteRequest], SuiteProgress] | None = None) -> None:
        self.asked: list[SuiteRequest] = []
        self.error: Exception | None = None
        endpoint = RunsEndpoint(TOKEN, put or self.take)
        self.server = WebServer("127.0.0.1", 0, list, str, put=endpoint.put)
        self.server.start()
        self.url = f"http://127.0.0.1:{self.server.port}"

    def take(self, request: SuiteRequest) -> SuiteProgress:
        if self.error:
            raise self.error
        self.asked.append(request)
        return SuiteProgress("finished", passed(request))

    def put(self, path: str, content: bytes, token: str = TOKEN) -> httpx.Response:
        return http_calls.put(self.url + path, content=content, headers={"Authorization": f"Bearer {token}"})


@pytest.fixture
def runner() -> Iterator[Runner]:
    stage = Runner()
    yield stage
    stage.server.stop()


def test_the_gates_client_and_the_server_understand_each_other(runner: Runner) -> None:
    request = make_request()
    client = SuiteRunnerClient(runner.url, TOKEN)
    assert client.run(request) == SuiteProgress("finished", passed(request))
    assert runner.asked == [request]
    runner.error = UnavailableError("64 runs wait already")
    with pytest.raises(UnavailableError, match="64 runs wait already"):
        client.run(request)
    runner.error = InputError("no such suite")
    with pytest.raises(InputError, match="no such suite"):
        client.run(request)
    client.disconnect()
    stranger = SuiteRunnerClient(runner.url, "guessed")
    with pytest.raises(UnavailableError, match="401"):
        stranger.run(request)
    stranger.disconnect()


BODY = json.dumps(request_document(make_request())).encode()


@pytest.mark.parametrize(
    ("path", "content", "status", "words"),
    [
        (f"/runs/{make_request().key}", b"{", 400, "not readable as JSON"),
        (f"/runs/{make_request().key}", b"[" * 100_000, 400, "nested deeper than 100 levels"),
        (f"/runs/{make_request().key}", b"[" * 101 + b"]" * 101, 400, "nested deeper than 100 levels"),
        (f"/runs/{make_request().key}", b"{}", 400, "artefact: missing"),
        (f"/runs/{'0' * 32}", BODY, 400, "the key of this request is"),
        ("/runs/", BODY, 404, "not found"),
        ("/elsewhere", BODY, 404, "not found"),
        (f"/runs/{make_request().key}", bytes(REQUEST_BYTES_MAX + 1), 413, "longer than"),
        (f"/runs/{make_request().key}", bytes(BODY_BYTES_MAX + 1), 413, "longer than"),
    ],
)
def test_requests_that_are_refused(runner: Runner, path: str, content: bytes, status: int, words: str) -> None:
    try:
        answer = runner.put(path, content)
    except httpx.TransportError:  # the server closed before all of it was sent
        assert len(content) > BODY_BYTES_MAX
        return
    assert (answer.status_code, words in answer.text) == (status, True), answer.text
    assert runner.asked == []


@pytest.fixture(scope="module")
def waiting() -> Iterator[Runner]:
    """A runner that puts what it is asked for into its queue, where it waits."""
    queue = SuiteQueue(MemoryExecutor(), [], needs_namespace)
    stage = Runner(queue.put)
    yield stage
    stage.server.stop()


@given(mistaken(request_document(make_request())))
def test_any_request_is_put_into_the_queue_or_refused(waiting: Runner, document: Any) -> None:
    answer = waiting.put(f"/runs/{make_request().key}", json.dumps(document).encode())
    assert answer.status_code in (200, 400)
    assert "status" in answer.json() if answer.status_code == 200 else answer.json()["message"]


@pytest.mark.parametrize("token", ["x", "guessed", "shared wor"])
def test_without_the_token_nothing_is_read(runner: Runner, token: str) -> None:
    assert runner.put(f"/runs/{make_request().key}", BODY, token).status_code == 401
    assert runner.asked == []


def test_a_server_without_put_takes_none() -> None:
    server = WebServer("127.0.0.1", 0, list, str)
    server.start()
    assert http_calls.put(f"http://127.0.0.1:{server.port}/runs/x", content=b"").status_code == 404
    server.stop()


def settings(folder: Path, **more: Any) -> Path:
    (folder / "forge").mkdir()
    for name in ("forge/username", "forge/password", "token"):
        (folder / name).write_text("word")
    charts = "oci://127.0.0.1:1"
    document = {
        "listen": {"address": "127.0.0.1", "port": 0},
        "log_level": "info",
        "forge": {"url": "http://127.0.0.1:1", "credentials": str(folder / "forge")},
        "oci_registry": {name: f"{charts}/{name}" for name in ("staging", "verified")}
        | {"images": f"{charts}/robotkube"},
        "token": str(folder / "token"),
        "platform_namespace": "robotkube",
        "agent": "cloud-0",
        "test_namespaces": [],
        "images": {"observer": "ros@x", "broker": "mosquitto@x", "database": ""},
        "database": {"kind": "", "arguments": []},
    }
    path = folder / "config.yaml"
    path.write_text(yaml.safe_dump(document | more))
    return path


@pytest.fixture
def process(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[bytes], str, str]]:
    """The process, and the URLs of its port and of its port for health."""
    listen = {"address": "127.0.0.1", "port": 0, "health_port": 0}
    environment = {**os.environ, "ROBOTKUBE_CONFIG": str(settings(tmp_path, listen=listen))}
    with (tmp_path / "log").open("wb") as log:
        command = [sys.executable, "-m", "robotkube.registry.suites"]
        program = subprocess.Popen(command, env=environment, stderr=log)
    lines: list[dict[str, Any]] = []

    def started() -> bool:
        lines[:] = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
        assert program.poll() is None, lines
        return any(line["event"] == "started" for line in lines)

    try:
        until(started, "the suite-runner started", START_SECONDS_MAX)
        started_line = next(line for line in lines if line["event"] == "started")
        yield program, *(f"http://127.0.0.1:{started_line[name]}" for name in ("port", "health_port"))
    finally:
        program.kill()
        program.wait(10)


def test_the_process_runs_suites_and_ends_on_sigterm(process: tuple[subprocess.Popen[bytes], str, str]) -> None:
    running, url, health = process
    client = SuiteRunnerClient(url, "word")
    request = make_request("static")
    request = replace(request, rule=replace(request.rule, version=StaticSuite.version))
    until(lambda: client.run(request).finished, "finished", START_SECONDS_MAX)
    result = client.run(request).result
    assert result is not None
    assert result.outcome == "unfinished"
    assert "OCI registry http://127.0.0.1:1" in result.checks[0].found
    elsewhere = replace(request, repository="robotkube/greeter", policy_digest=request.artefact.digest)
    until(lambda: client.run(elsewhere).finished, "finished", START_SECONDS_MAX)
    assert "must be in staging" in str(client.run(elsewhere).result)
    assert "without a pool" in client.run(make_request("install")).reason
    client.disconnect()
    for place in (url, health):
        assert http_calls.get(f"{place}/livez").status_code == 200
        assert http_calls.get(f"{place}/readyz").status_code == 200
        assert '{outcome="unfinished",suite="static"} 2' in http_calls.get(f"{place}/metrics").text
    running.terminate()
    assert running.wait(10) == 0


def test_wrong_settings_are_named_at_once(tmp_path: Path) -> None:
    test_namespace = {"namespace": "a", "domain_id": 500}
    path = settings(
        tmp_path, test_namespaces=[test_namespace], agent="", database={"kind": "oracle", "arguments": []}, key="k"
    )
    environment = {**os.environ, "ROBOTKUBE_CONFIG": str(path)}
    command = [sys.executable, "-m", "robotkube.registry.suites"]
    done = subprocess.run(command, env=environment, capture_output=True, timeout=START_SECONDS_MAX, check=False)
    assert done.returncode == 2
    for words in ("key: unknown key", "agent: ", "database.kind: must be", "test_namespaces[0].domain_id: must be"):
        assert words in done.stderr.decode()


def test_former_keys_are_taken_with_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = settings(tmp_path, test_namespaces=[{"namespace": "robotkube-suite-0", "domain_id": 90}])
    today = read_settings(path, read_configuration, FORMER_KEYS)
    warn_of_former_keys(path, FORMER_KEYS)
    assert caplog.messages == []
    document = yaml.safe_load(path.read_text())
    document["rooms"] = document.pop("test_namespaces")
    document["registry"] = document.pop("oci_registry")
    path.write_text(yaml.safe_dump(document))
    former = read_settings(path, read_configuration, FORMER_KEYS)
    assert former == today
    warn_of_former_keys(path, FORMER_KEYS)
    assert caplog.messages == [
        f"settings have a former key file={path} key=rooms new_key=test_namespaces",
        f"settings have a former key file={path} key=registry new_key=oci_registry",
    ]


def test_a_key_under_both_names_is_refused(tmp_path: Path) -> None:
    path = settings(tmp_path, rooms=[])
    with pytest.raises(DocumentError, match="rooms: is the former name of test_namespaces, which is there as well"):
        read_settings(path, read_configuration, FORMER_KEYS)
