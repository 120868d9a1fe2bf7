"""The manager as its pod runs it: one process, its settings file, a real forge with its gate, a real API server."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from evidence_of_tests import key_folder
from installation import CHARTS_URL, WEBHOOK_SECRET, Installation, RunningGate

sys.path.insert(0, str(Path(__file__).parents[1] / "apiserver"))

from api_calls import TASKS, Api, prepare
from api_server import ApiServerProcess
from programs import free_port
from waiting import until

from robotkube.adapters.kubernetes_api import api_client, call
from robotkube.adapters.webhooks import sign

pytestmark = pytest.mark.filterwarnings("ignore::urllib3.exceptions.InsecureRequestWarning")
AGENTS = (("cloud-0", "cloud"), ("vehicle-00", "vehicle"), ("vehicle-01", "vehicle"))
END_SECONDS_MAX = 10


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    process = ApiServerProcess(tmp_path_factory.mktemp("api"))
    try:
        process.start()
        found = Api(api_client(str(process.kubeconfig)))
        prepare(found)
        for name, role in AGENTS:
            labels = {
                "robotkube.io/agent": name,
                "robotkube.io/role": role,
                "robotkube.io/capability.recording": "true",
            }
            found.post(
                "/api/v1/nodes", {"apiVersion": "v1", "kind": "Node", "metadata": {"name": name, "labels": labels}}
            )
            ready = {"type": "Ready", "status": "True", "lastTransitionTime": "2026-11-21T10:00:00Z"}
            found.merge(f"/api/v1/nodes/{name}/status", {"status": {"conditions": [ready]}})
        found.kubeconfig = process.kubeconfig  # type: ignore[attr-defined]
        yield found
        found.client.rest_client.pool_manager.clear()
    finally:
        process.stop()


def settings(installation: Installation, folder: Path, port: int) -> Path:
    """The settings file and secrets, as the platform chart mounts them."""
    for name, text in {
        "forge/username": "manager", "forge/password": installation.passwords["manager"],
        "argocd/username": "manager", "argocd/password": "x", "hook/secret": "s", "webhook/secret": WEBHOOK_SECRET,
    }.items():  # fmt: skip
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    nowhere = f"http://127.0.0.1:{free_port()}"
    document = {
        "listen": {"address": "127.0.0.1", "port": port},
        "log_level": "info",
        "forge": {
            "url": installation.url, "credentials": f"{folder}/forge", "deployment": "robotkube/deployment",
            "catalogue": "robotkube/catalogue", "branch": "main",
        },
        "registry": {"charts": CHARTS_URL},
        "evidence": {"keys": str(key_folder())},
        "argocd": {
            "url": nowhere, "credentials": f"{folder}/argocd", "namespace": "argocd", "project": "robotkube-apps",
        },
        "hook": {"url": f"{nowhere}/api/webhook", "secret": f"{folder}/hook/secret"},
        "webhook": {"secret": f"{folder}/webhook/secret"},
        "agents": [{"name": n, "role": r, "namespace": n, "records": r == "cloud"} for n, r in AGENTS],
    }  # fmt: skip
    (folder / "config.yaml").write_text(yaml.safe_dump(document))
    return folder / "config.yaml"


class Pod:
    """The process and its pages."""

    def __init__(self, config: Path, kubeconfig: Path, folder: Path, port: int) -> None:
        environment = {
            **os.environ, "ROBOTKUBE_CONFIG": str(config), "KUBECONFIG": str(kubeconfig), "HOME": str(folder),
            "ROBOTKUBE_WORK": str(folder / "work"),
        }  # fmt: skip
        self.log = folder / "manager.log"
        with self.log.open("wb") as log:
            command = [sys.executable, "-m", "robotkube.entrypoints.manager"]
            self.process = subprocess.Popen(command, env=environment, stderr=log)
        self.url = f"http://127.0.0.1:{port}"

    def get(self, path: str) -> httpx.Response | None:
        assert self.process.poll() is None, self.log.read_text()
        try:
            return httpx.get(f"{self.url}{path}")
        except httpx.ConnectError:
            return None

    def ready(self) -> bool:
        answer = self.get("/readyz")
        return answer is not None and answer.is_success

    def plans(self) -> list[dict[str, Any]]:
        answer = self.get("/plans")
        assert answer is not None
        return list(answer.json()["plans"])

    def end(self) -> int:
        self.process.send_signal(signal.SIGTERM)
        try:
            return self.process.wait(END_SECONDS_MAX)
        finally:
            self.process.kill()


@pytest.fixture
def pod(installation: Installation, gate: RunningGate, api: Api, tmp_path: Path) -> Iterator[Pod]:
    port = free_port()
    config = settings(installation, tmp_path, port)
    found = Pod(config, api.kubeconfig, tmp_path, port)  # type: ignore[attr-defined]
    yield found
    found.process.kill()
    found.process.wait(END_SECONDS_MAX)


def test_a_task_of_the_api_server_is_on_main_within_seconds(pod: Pod, api: Api) -> None:
    until(pod.ready, "ready", 30)
    until(lambda: all(p["on_main"] or p["error"] for p in pod.plans()), "initial configuration on main")
    begin = time.monotonic()
    api.task("meeting", application="pose-point-cloud-recording", parameters={"vehicles": ["vehicle-00", "vehicle-01"]})
    until(lambda: status(api)[0].get("Committed") == "True", "committed")
    assert time.monotonic() - begin < 10
    assert status(api)[0]["Accepted"] == "True"
    assert len(status(api)[1]["commit"]) == 40
    assert status(api)[1]["releases"][1] == "cloud-0/recorder-vehicle-00-vehicle-01"
    assert (pod.plans()[-1]["cause"], pod.plans()[-1]["tasks"]) == ("task", ["cloud-0/meeting"])
    catalogue = pod.get("/catalogue")
    assert catalogue is not None
    assert "proximity-operator" in catalogue.text
    body = json.dumps({"repository": {"full_name": "robotkube/deployment"}}).encode()
    headers = {"X-Gitea-Event": "push", "X-Gitea-Signature": sign(body, WEBHOOK_SECRET.encode())}
    assert httpx.post(f"{pod.url}/webhook", content=body, headers=headers).status_code == 204
    assert httpx.post(f"{pod.url}/webhook", content=body, headers={}).status_code == 401
    assert "robotkube_manager_plans_total" in httpx.get(f"{pod.url}/metrics").text
    api.delete(f"{TASKS}/meeting")
    until(lambda: pod.plans()[-1]["cause"] == "withdrawal" and pod.plans()[-1]["on_main"], "withdrawn")
    assert pod.end() == 0


def status(api: Api) -> tuple[dict[str, str], dict[str, Any]]:
    found = json.loads(call(api.client, "GET", f"{TASKS}/meeting").data).get("status", {})
    return {c["type"]: c["status"] for c in found.get("conditions", [])}, found


def test_wrong_settings_end_the_process_with_the_file_and_the_key(pod: Pod, tmp_path: Path) -> None:
    pod.end()
    config = tmp_path / "config.yaml"
    config.write_text(config.read_text().replace("branch: main", "branch: main\n  surprise: 1"))
    environment = {**os.environ, "ROBOTKUBE_CONFIG": str(config)}
    command = [sys.executable, "-m", "robotkube.entrypoints.manager"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 2
    assert "forge.surprise: unknown key" in done.stderr
    assert str(config) in done.stderr
