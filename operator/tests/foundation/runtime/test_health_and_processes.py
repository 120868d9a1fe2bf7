"""Health port, API client, process frame: over real sockets and real processes."""

from __future__ import annotations

import http.client
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator

import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.kubernetes.adapters.http_client import (
    ApiServer,
    ConfigMapWatch,
    config_map_path,
    custom_path,
    split_name,
)
from robotkube.foundation.runtime.adapters.health_server import HealthServer
from robotkube.testing.api_server import ApiServerInMemory
from tests.stages.paths import SOURCE

pytestmark = pytest.mark.processes

WAIT_SECONDS = 30.0


def eventually(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + WAIT_SECONDS
    while not condition():
        assert time.monotonic() < deadline, "did not happen in time"
        time.sleep(0.01)


def fetch(server: HealthServer, path: str, method: str = "GET") -> tuple[int, str]:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=5)
    connection.request(method, path)
    response = connection.getresponse()
    result = response.status, response.read().decode()
    connection.close()
    return result


def test_health_says_what_is_missing() -> None:
    complaints: list[str | None] = ["not connected"]

    def broken() -> str:
        raise RuntimeError("no input yet")

    pages = {"/input": lambda: json.dumps({"a": 1}), "/broken": broken}
    server = HealthServer(
        ready=lambda: complaints[0], metrics=lambda: "x 1\n", pages=pages, port=0, address="127.0.0.1"
    )
    server.start()
    assert fetch(server, "/livez") == (200, "ok\n")
    assert fetch(server, "/readyz") == (503, "not connected\n")
    complaints[0] = None
    assert fetch(server, "/readyz?verbose") == (200, "ok\n")
    assert fetch(server, "/metrics") == (200, "x 1\n")
    assert fetch(server, "/input") == (200, '{"a": 1}')
    assert fetch(server, "/broken")[0] == 500
    assert fetch(server, "/nowhere")[0] == 404
    assert fetch(server, "/livez", "POST")[0] == 405
    server.close()


@pytest.fixture
def api(server: ApiServerInMemory) -> Iterator[ApiServer]:
    client = ApiServer(server.url)
    yield client
    client.close()


@pytest.fixture
def server() -> Iterator[ApiServerInMemory]:
    with ApiServerInMemory() as running:
        yield running


def test_objects_are_made_changed_and_removed(api: ApiServer) -> None:
    path = custom_path("robotkube.io", "v1alpha1", "cloud-0", "taskdescriptions")
    body = {"metadata": {"name": "t1"}, "spec": {"a": 1, "b": 2}}
    assert api.get(f"{path}/t1") is None
    assert api.create(path, body)
    assert not api.create(path, body)
    assert api.patch(f"{path}/t1", {"spec": {"b": None, "c": 3}})
    task = api.get(f"{path}/t1")
    assert task is not None
    assert task["spec"] == {"a": 1, "c": 3}
    assert api.delete(f"{path}/t1")
    assert not api.delete(f"{path}/t1")
    assert not api.patch(f"{path}/t1", {})
    assert api.get(config_map_path("cloud-0", "nothing")) is None


def test_a_config_map_is_followed(server: ApiServerInMemory) -> None:
    seen: list[object] = []
    watch = ConfigMapWatch(ApiServer(server.url), "vehicle-00", "simulation", seen.append)
    watch.start()
    eventually(lambda: seen == [None])
    server.put_config_map("vehicle-00", "other", {"x": "y"})
    server.put_config_map("vehicle-01", "simulation", {"x": "y"})
    server.put_config_map("vehicle-00", "simulation", {"run": "1"})
    eventually(lambda: len(seen) == 2)
    server.put_config_map("vehicle-00", "simulation", {"run": "2"})
    eventually(lambda: len(seen) == 3)
    server.put_config_map("vehicle-00", "simulation", None)
    eventually(lambda: len(seen) == 4)
    assert seen == [None, {"run": "1"}, {"run": "2"}, None]
    assert watch.complaint is None
    watch.stop()


def test_a_watch_survives_its_server() -> None:
    seen: list[object] = []
    with ApiServerInMemory() as first:
        port = int(first.url.rpartition(":")[2])
        first.put_config_map("a", "m", {"n": "1"})
        watch = ConfigMapWatch(ApiServer(first.url), "a", "m", seen.append)
        watch.start()
        eventually(lambda: seen)
    eventually(lambda: watch.complaint is not None)
    with ApiServerInMemory(port=port) as second:
        second.put_config_map("a", "m", {"n": "2"})
        eventually(lambda: seen[-1] == {"n": "2"} and watch.complaint is None)
        watch.stop()


def test_a_follower_that_fails_does_not_end_the_watch(server: ApiServerInMemory) -> None:
    failures: list[str] = []
    seen: list[object] = []

    def changed(data: object) -> None:
        seen.append(data)
        raise RuntimeError("cannot apply")

    watch = ConfigMapWatch(ApiServer(server.url), "a", "m", changed, failures.append)
    watch.start()
    eventually(lambda: failures)
    server.put_config_map("a", "m", {"n": "1"})
    eventually(lambda: len(seen) == 2)
    assert "ConfigMap a/m: RuntimeError: cannot apply" in failures[0]
    watch.stop()


def test_errors_say_whether_to_try_again() -> None:
    with pytest.raises(UnavailableError, match=r"API server http://127.0.0.1:9, GET /x"):
        ApiServer("http://127.0.0.1:9", timeout_seconds=1).get("/x")
    with pytest.raises(InputError, match="ROBOTKUBE_API_SERVER"):
        ApiServer.from_environment({})
    assert ApiServer.from_environment({"KUBERNETES_SERVICE_HOST": "fd00::1"}).url == "https://[fd00::1]:443"
    with pytest.raises(InputError, match="write it as <namespace>/<name>"):
        split_name("simulation")


def test_many_threads_share_the_client(api: ApiServer) -> None:
    path = custom_path("robotkube.io", "v1alpha1", "cloud-0", "taskdescriptions")
    made: list[bool] = []
    threads = [
        threading.Thread(target=lambda n=n: made.append(api.create(path, {"metadata": {"name": f"t{n % 5}"}})))
        for n in range(20)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(WAIT_SECONDS)
    assert sorted(made) == [False] * 15 + [True] * 5


PROGRAMS = {
    "ends": "p.log('started'); assert p.stopping.wait(600)",
    "hangs": "import time\n    p.log('started'); p.stopping.wait(600); time.sleep(600)",
    "refused": "raise InputError('config.yaml: agent: missing; add it')",
    "unreachable": "raise UnavailableError('broker away')",
    "fails": "raise RuntimeError('bug')",
}


def program(name: str, grace_seconds: float = WAIT_SECONDS) -> subprocess.Popen[str]:
    text = (
        "from robotkube.foundation.runtime.process import run\n"
        "from robotkube.errors import InputError, UnavailableError\n"
        f"def body(p):\n    {PROGRAMS[name]}\nrun('test', body, {grace_seconds})\n"
    )
    return subprocess.Popen(
        [sys.executable, "-c", text], stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": str(SOURCE)}
    )


@pytest.mark.parametrize(
    ("name", "code", "words"),
    [("refused", 2, "agent: missing"), ("unreachable", 3, "broker away"), ("fails", 1, "RuntimeError: bug")],
)
def test_exit_codes_and_last_line(name: str, code: int, words: str) -> None:
    process = program(name)
    _, errors = process.communicate(timeout=WAIT_SECONDS)
    assert process.returncode == code
    assert words in json.loads(errors.splitlines()[-1])["error"]


@pytest.mark.parametrize(("name", "code", "grace_seconds"), [("ends", 0, WAIT_SECONDS), ("hangs", 1, 0.5)])
def test_sigterm_ends_a_process_in_time(name: str, code: int, grace_seconds: float) -> None:
    process = program(name, grace_seconds)
    assert process.stderr is not None
    process.stderr.readline()
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=WAIT_SECONDS)
    assert process.returncode == code
    assert ("Timeout (0:00:00.5" in errors) == (name == "hangs")
