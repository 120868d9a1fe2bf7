"""The manager as its pod runs it: one process, its settings file, a real forge with its gate, a real API server. It
serves and asks by HTTPS."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from robotkube.delivery.gate.__main__ import OBJECTS_PATH, objects_posts
from robotkube.foundation.certificates.adapters import certificate_authorities
from robotkube.foundation.certificates.adapters.issuing import new_authority
from robotkube.foundation.kubernetes.adapters.client import call
from robotkube.foundation.runtime.adapters.webhook_server import WebServer
from robotkube.foundation.runtime.core.webhook_deliveries import sign
from tests.stages import http_calls
from tests.stages.delivery.manager.manager_process import Pod, write_settings
from tests.stages.forge.installation import WEBHOOK_SECRET, Installation, RunningGate, manager_secret, outside
from tests.stages.handshakes import certified, written
from tests.stages.kubernetes.api_calls import TASKS, Api
from tests.stages.programs import free_port
from tests.stages.waiting import until

HERE = "127.0.0.1"
pytestmark = pytest.mark.toolchain


@pytest.fixture
def certificate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Of an authority that the test believes as well."""
    monkeypatch.setattr(certificate_authorities, "_trusted", {})
    authority = new_authority("ours", time.time())
    certificate_authorities.trust(written(tmp_path / "authorities", authority))
    return certified(tmp_path / "certificate", authority, HERE)


@pytest.fixture
def objects_url(gate: RunningGate, certificate: Path) -> Iterator[str]:
    """The address at which the gate takes commit objects by HTTPS."""
    posts = objects_posts(gate.gate, "robotkube/deployment", {"manager": manager_secret()})
    server = WebServer(HERE, 0, list, str, signed=posts, certificate=certificate)
    server.start()
    yield f"https://{HERE}:{server.port}{OBJECTS_PATH}/manager"
    server.stop()


@pytest.fixture
def pod(
    installation: Installation, objects_url: str, certificate: Path, manager_api: Api, tmp_path: Path
) -> Iterator[Pod]:
    port = free_port()
    lease = manager_api.lease()
    listen = {"address": HERE, "port": port, "health_port": free_port(), "certificate": str(certificate)}
    settings = write_settings(
        replace(outside(installation), objects_url=objects_url),
        *(tmp_path, port, lease),
        listen=listen,
        authorities=f"{tmp_path}/authorities/ca.crt",
    )
    document = yaml.safe_load(settings.read_text())
    document["lease"]["server_name"] = "manager.robotkube.svc.cluster.local"
    settings.write_text(yaml.safe_dump(document))
    started = Pod(settings, manager_api.kubeconfig, port, "manager-0")
    started.url = f"https://{HERE}:{port}"
    yield started
    started.kill()


def test_a_task_of_the_api_server_is_on_main(pod: Pod, manager_api: Api, gate: RunningGate, tmp_path: Path) -> None:
    until(pod.ready, "ready")
    until(lambda: all(p["on_main"] or p["error"] for p in pod.plans()), "initial configuration on main")
    manager_api.task(
        "meeting", application="pose-point-cloud-recording", parameters={"vehicles": ["vehicle-00", "vehicle-01"]}
    )
    until(lambda: status(manager_api)[0].get("Committed") == "True", "committed")
    assert status(manager_api)[0]["Accepted"] == "True"
    assert len(status(manager_api)[1]["commit"]) == 40
    assert status(manager_api)[1]["releases"][1] == "cloud-0/recorder-vehicle-00-vehicle-01"
    answer = next(plan for plan in pod.plans() if plan["commit"] == status(manager_api)[1]["commit"])
    assert (answer["cause"], "cloud-0/meeting" in answer["tasks"]) == ("task", True)
    catalogue = pod.get("/catalogue")
    assert catalogue is not None
    assert "proximity-operator" in catalogue.text
    body = json.dumps({"repository": {"full_name": "robotkube/deployment"}}).encode()
    headers = {"X-Gitea-Event": "push", "X-Gitea-Signature": sign(body, manager_secret().encode())}
    assert http_calls.post(f"{pod.url}/webhook", content=body, headers=headers).status_code == 204
    headers["X-Gitea-Signature"] = sign(body, WEBHOOK_SECRET.encode())
    assert http_calls.post(f"{pod.url}/webhook", content=body, headers=headers).status_code == 401, (
        "signed for the gate"
    )
    assert http_calls.post(f"{pod.url}/webhook", content=body, headers={}).status_code == 401
    health = yaml.safe_load((tmp_path / "config.yaml").read_text())["listen"]["health_port"]
    for url in (pod.url, f"http://{HERE}:{health}"):
        assert http_calls.get(f"{url}/readyz").status_code == 200
        assert "robotkube_manager_plans_total" in http_calls.get(f"{url}/metrics").text
    manager_api.delete(f"{TASKS}/meeting")
    until(lambda: pod.plans()[-1]["cause"] == "withdrawal" and pod.plans()[-1]["on_main"], "withdrawn")
    assert gate.gate.statistics.sources["sent"] > 0, "its objects were sent"
    assert pod.end() == 0


def status(manager_api: Api) -> tuple[dict[str, str], dict[str, Any]]:
    written = json.loads(call(manager_api.client, "GET", f"{TASKS}/meeting").data).get("status", {})
    return {c["type"]: c["status"] for c in written.get("conditions", [])}, written


def test_wrong_settings_end_the_process_with_the_file_and_the_key(pod: Pod, tmp_path: Path) -> None:
    pod.end()
    config = tmp_path / "config.yaml"
    config.write_text(config.read_text().replace("branch: main", "branch: main\n  surprise: 1"))
    environment = {**os.environ, "ROBOTKUBE_CONFIG": str(config)}
    command = [sys.executable, "-m", "robotkube.delivery.manager"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 2
    assert "forge.surprise: unknown key" in done.stderr
    assert str(config) in done.stderr
