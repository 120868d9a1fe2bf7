"""The console's process on a real API server and a manager's pages: what changes there is told to who listens."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml

from robotkube.delivery.console.__main__ import ConsoleProcess
from robotkube.delivery.console.settings import read_configuration
from robotkube.foundation.certificates.adapters import certificate_authorities
from robotkube.foundation.certificates.adapters.issuing import new_authority
from robotkube.foundation.kubernetes.adapters.client import api_client
from robotkube.foundation.runtime.adapters.webhook_server import WebServer
from robotkube.foundation.runtime.settings_file import read_settings
from tests.delivery.console import documents as given
from tests.delivery.console.test_settings import LEAST
from tests.stages.handshakes import certified, written
from tests.stages.kubernetes.api_calls import ARGOCD, TASKS, Api
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.waiting import until

pytestmark = [pytest.mark.toolchain, pytest.mark.thorough]
NODE, TASK = "/api/v1/nodes/cloud-0", "console-meeting"


class Manager:
    """A manager's pages, by HTTPS."""

    def __init__(self, certificate: Path) -> None:
        self.plans: dict[str, Any] = {"plans": []}
        pages = {"/plans": lambda: self.plans, "/catalogue": lambda: given.CATALOGUE}
        self.server = WebServer("127.0.0.1", 0, list, str, pages=pages, certificate=certificate)
        self.server.start()


@pytest.fixture
def authorities(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of who signed the manager's certificate."""
    monkeypatch.setattr(certificate_authorities, "_trusted", {})
    authority = new_authority("ours", time.time())
    certified(tmp_path / "certificate", authority, "127.0.0.1")
    return written(tmp_path / "authorities", authority)


@pytest.fixture
def manager(authorities: Path, tmp_path: Path) -> Iterator[Manager]:
    made = Manager(tmp_path / "certificate")
    yield made
    made.server.stop()


@pytest.fixture
def console(
    api_server: ApiServerProcess, manager: Manager, authorities: Path, tmp_path: Path
) -> Iterator[httpx.Client]:
    """A running console, asked as a browser would."""
    managers = [{"name": "manager", "url": f"https://127.0.0.1:{manager.server.port}"}]
    path = tmp_path / "config.yaml"
    path.write_text(yaml.safe_dump({**LEAST, "managers": managers, "authorities": str(authorities)}))
    api = api_client(str(api_server.kubeconfig))
    process = ConsoleProcess(read_settings(path, read_configuration), api)
    stopping = threading.Event()
    running = threading.Thread(target=process.run, args=(stopping,))
    running.start()
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{process.server.port}", timeout=10) as client:
            until(lambda: not process.watches.missing(), "all is listed")
            yield client
    finally:
        stopping.set()
        running.join(15)
        api.rest_client.pool_manager.clear()
    assert not running.is_alive()


def items(console: httpx.Client, kind: str) -> dict[str, Any]:
    of_kind: dict[str, Any] = console.get("/api/snapshot").raise_for_status().json()["items"].get(kind, {})
    return of_kind


def test_what_changes_in_the_cluster_is_told_in_a_stream(api: Api, console: httpx.Client, manager: Manager) -> None:
    until(lambda: set(items(console, "sources")) >= {"api-server-nodes", "manager/manager"}, "sources are known")
    assert items(console, "sources")["api-server-tasks"]["ok"] is True
    assert items(console, "sources")["api-server-inspections"]["ok"] is False, "this server has no such kind"
    until(lambda: "gate" in items(console, "sources"), "it was looked for the gate")
    assert items(console, "sources")["gate"]["problem"] == "There is no pod of it."
    assert "argocd-application-controller" not in items(console, "sources"), "it was never there"
    assert items(console, "agents")["cloud-0"]["nodes"] == []
    after = console.get("/api/snapshot").json()["id"]
    with console.stream("GET", "/api/events", params={"after": after}) as stream:
        notified = changes(stream)
        api.node("cloud-0", "cloud")
        api.task(TASK, reason="two meet")
        manager.plans = given.plans(tasks=[f"cloud-0/{TASK}"], events=["e1"])
        source = {"repoURL": "oci://forge/verified/event-detector", "helm": {"releaseName": "recorder"}}
        spec = {"project": "default", "destination": {"namespace": "cloud-0"}, "source": source}
        body = {"apiVersion": "argoproj.io/v1alpha1", "kind": "Application", "metadata": {"name": "cloud-0-recorder"}}
        api.post(ARGOCD, {**body, "spec": spec})
        seen: dict[str, dict[str, Any]] = {}
        gone: dict[str, list[str]] = {}
        wanted = {"agents": "cloud-0", "tasks": f"cloud-0/{TASK}", "plans": given.PLAN, "releases": given.RECORDER}
        while not all(key in seen.get(kind, {}) for kind, key in wanted.items()):
            for kind, documents in next(notified)["set"].items():
                seen.setdefault(kind, {}).update(documents)
        assert seen["agents"]["cloud-0"]["ready"] is True
        assert seen["events"]["e1"]["task"] == f"cloud-0/{TASK}"
        chain = console.get(f"/api/why/task/cloud-0/{TASK}").json()["steps"]
        assert {step["step"] for step in chain} >= {"event", "task", "plan", "commit", "Application"}
        api.delete(f"{TASKS}/{TASK}")
        api.delete(f"{ARGOCD}/cloud-0-recorder")
        api.delete(NODE)
        while not {"tasks", "releases"} <= set(gone):
            change = next(notified)
            gone |= change["gone"]
    assert gone["releases"] == [given.RECORDER]
    assert console.get(f"/api/changes?after={after}").json()["gone"]["tasks"] == [f"cloud-0/{TASK}"]


def changes(stream: httpx.Response) -> Iterator[dict[str, Any]]:
    """The documents of the events `change`."""
    name = ""
    for line in stream.iter_lines():
        if line.startswith("event: "):
            name = line.removeprefix("event: ")
        elif line.startswith("data: ") and name == "change":
            yield json.loads(line.removeprefix("data: "))
