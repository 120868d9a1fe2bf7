"""Teardown: what it decides, against releases in memory; and its wire, against a small API server."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from robotkube.errors import DocumentError, InputError, UnavailableError
from robotkube.foundation.runtime.process import Process
from robotkube.foundation.runtime.settings_file import read_settings
from robotkube.setup.loops.teardown import TeardownClock, tear_down
from robotkube.setup.teardown import body, read_configuration

SETTINGS = """\
log_level: info
argocd: {namespace: argocd, project: robotkube-apps, application_set: releases}
wait_seconds: 3
"""


class Seconds:
    """A clock that only sleeping moves."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def clock(self) -> TeardownClock:
        def sleep(seconds: float) -> bool:
            self.seconds += seconds
            return True

        return TeardownClock(lambda: self.seconds, sleep)


class Releases:
    """Applications that go one per look once they are withdrawn; `faults` are raised first."""

    def __init__(self, names: Sequence[str], faults: Sequence[Exception] = (), stuck: bool = False) -> None:
        self.names = list(names)
        self.faults = list(faults)
        self.stuck = stuck
        self.withdrawn = False

    def withdraw(self) -> bool:
        if self.faults:
            raise self.faults.pop(0)
        was, self.withdrawn = self.withdrawn, True
        return not was

    def remaining(self) -> Sequence[str]:
        left = tuple(self.names)
        if self.withdrawn and not self.stuck and self.names:
            self.names.pop()
        return left


def test_waits_until_all_releases_are_gone() -> None:
    releases = Releases(["a", "b"])
    seconds = Seconds()
    assert tear_down(releases, 30, seconds.clock()) == 2
    assert releases.withdrawn
    assert seconds.seconds == 2


def test_without_releases_it_is_done_at_once() -> None:
    seconds = Seconds()
    assert tear_down(Releases([]), 30, seconds.clock()) == 0
    assert seconds.seconds == 0


def test_says_what_is_left_and_what_to_do_when_the_time_is_over() -> None:
    names = [f"vehicle-0{index}-mqtt-bridge" for index in range(7)]
    with pytest.raises(UnavailableError, match=r"within 5 s; still there: vehicle-00-.* and 2 more\. See whether Argo"):
        tear_down(Releases(names, stuck=True), 5, Seconds().clock())


def test_tries_again_after_a_passing_fault() -> None:
    assert tear_down(Releases([], [UnavailableError("away")]), 5, Seconds().clock()) == 0


def test_gives_up_at_once_when_it_is_not_allowed() -> None:
    seconds = Seconds()
    with pytest.raises(InputError, match="forbidden"):
        tear_down(Releases([], [InputError("forbidden")]), 5, seconds.clock())
    assert seconds.seconds == 0


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (SETTINGS.replace("wait_seconds: 3", "wait_seconds: 0"), "wait_seconds: must be a whole number"),
        (SETTINGS + "colour: red\n", "colour: unknown key"),
        (SETTINGS.replace("namespace: argocd, ", ""), "argocd.namespace: missing"),
        (SETTINGS.replace("info", "loud"), "log_level: must be one of"),
        ("a: [", "YAML"),
    ],
)
def test_settings_are_read_strictly(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "config.yaml"
    path.write_text(text)
    with pytest.raises(DocumentError, match=problem) as caught:
        read_settings(path, read_configuration)
    assert str(path) in str(caught.value)


@pytest.fixture
def api_server() -> Iterator[tuple[str, list[str]]]:
    """An API server with an ApplicationSet and a foreign Application."""
    calls: list[str] = []
    ours = ["vehicle-00-mqtt-bridge", "cloud-0-event-detector"]

    class Handler(BaseHTTPRequestHandler):
        def do_DELETE(self) -> None:
            calls.append(f"DELETE {self.path}")
            known = bool(ours) and self.path.endswith("/applicationsets/releases")
            ours.clear()
            self.answer(200 if known else 404, {})

        def do_GET(self) -> None:
            calls.append(f"GET {self.path}")
            foreign = {"metadata": {"name": "foreign"}, "spec": {"project": "other"}}
            self.answer(200, {"metadata": {}, "items": [foreign]})

        def answer(self, status: int, document: dict[str, Any]) -> None:
            data = json.dumps(document).encode()
            self.send_response(status)
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        def log_message(self, *arguments: Any) -> None:
            return

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}", calls
    server.shutdown()
    server.server_close()
    thread.join(5)


def test_deletes_the_application_set_and_leaves_foreign_applications_alone(
    tmp_path: Path, api_server: tuple[str, list[str]]
) -> None:
    url, calls = api_server
    (tmp_path / "config.yaml").write_text(SETTINGS)
    body(
        Process("teardown", 1.0),
        {"ROBOTKUBE_API_SERVER": url, "ROBOTKUBE_CONFIG": str(tmp_path / "config.yaml")},
    )
    assert calls == [
        "DELETE /apis/argoproj.io/v1alpha1/namespaces/argocd/applicationsets/releases",
        "GET /apis/argoproj.io/v1alpha1/namespaces/argocd/applications?limit=500&continue=",
    ]
