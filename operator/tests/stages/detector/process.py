"""What tests of the detector's process need: an API server in short, its pages, and the publisher of its inputs."""

from __future__ import annotations

import json
import socket
import threading
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

PUBLISHER = ("-m", "tests.stages.ros.pose_publisher")
COMMAND = ("-m", "robotkube.robots.detector")
SECONDS_MAX = 30.0
PATH = "/apis/robotkube.io/v1alpha1/namespaces/cloud-0/taskdescriptions"


class Api(ThreadingHTTPServer):
    """Keeps TaskDescriptions and one ConfigMap, as far as the detector asks for them; `calls` are the changes."""

    def __init__(self, settings: str) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.objects: dict[str, Any] = {}
        self.calls: list[tuple[str, str]] = []
        self.warnings: list[dict[str, Any]] = []
        self.settings = settings
        self.changed = threading.Event()
        self.closing = threading.Event()


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: Api

    def do_GET(self) -> None:
        if "watch=true" in self.path:
            self.watch()
        elif "/configmaps" in self.path:
            self.answer(200, {"metadata": {"resourceVersion": "1"}, "items": [self.config_map()]})
        else:
            self.answer(200, {"items": list(self.server.objects.values())})

    def do_POST(self) -> None:
        task = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        if self.path == "/apis/events.k8s.io/v1/namespaces/cloud-0/events":
            self.server.warnings.append(task)
            self.answer(201, task)
            return
        self.server.objects[task["metadata"]["name"]] = task
        self.server.calls.append(("create", task["metadata"]["name"]))
        self.answer(201, task)

    def do_DELETE(self) -> None:
        name = self.path.removeprefix(PATH + "/")
        self.server.calls.append(("delete", name))
        self.answer(200 if self.server.objects.pop(name, None) else 404, {})

    def watch(self) -> None:
        self.send_response(200)
        self.end_headers()
        while not self.server.closing.wait(0.05):
            if self.server.changed.is_set():
                self.server.changed.clear()
                self.wfile.write(json.dumps({"type": "MODIFIED", "object": self.config_map()}).encode() + b"\n")
                self.wfile.flush()
        self.close_connection = True

    def config_map(self) -> dict[str, Any]:
        return {"metadata": {"name": "event-detector"}, "data": {"config.yaml": self.server.settings}}

    def answer(self, status: int, document: Any) -> None:
        body = json.dumps(document).encode()
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: Any) -> None:
        return None


def move(folder: Path, metres: float) -> None:
    """Have the publisher's vehicle-01 stand so far from vehicle-00."""
    (folder / "new").write_text(str(metres))
    (folder / "new").replace(folder / "place")


@contextmanager
def kept_port() -> Iterator[int]:
    """A port that the kernel gives to nobody else meanwhile; whoever is told of it may listen there."""
    with socket.socket() as holder:
        holder.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        holder.bind(("127.0.0.1", 0))
        yield int(holder.getsockname()[1])


def read(port: int, path: str, data: bytes | None = None) -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", data, timeout=SECONDS_MAX) as answer:
        return str(answer.read().decode())


def is_up(port: int) -> bool:
    try:
        return read(port, "/livez") == "ok\n"
    except OSError:
        return False
