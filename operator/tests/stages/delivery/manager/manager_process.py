"""The manager as its pod runs it, for tests: settings, process; and a process that ends at one of its writes.

    python3 -m tests.stages.delivery.manager.manager_process POINT FLAG

POINT: `<kill|stop> <before|after> <module.class.method>`. Runs the entry point; at the first such
write it makes the file FLAG and sends itself SIGKILL or SIGSTOP.
"""

import functools
import importlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import yaml

from tests.stages import http_calls

END_SECONDS_MAX = 10
SIGNALS = {"kill": signal.SIGKILL, "stop": signal.SIGSTOP}
AGENTS = (("cloud-0", "cloud"), ("vehicle-00", "vehicle"), ("vehicle-01", "vehicle"))
EVERYTHING = {"namespaces": ["*"], "agents": ["*"], "applications": ["*"]}


@dataclass(frozen=True)
class Outside:
    """What the settings of a manager name: the forge, the keys' folder, where charts come from, and objects go to."""

    forge_url: str
    password: str
    webhook_secret: str
    keys: Path
    charts_url: str
    nowhere: str
    objects_url: str = ""


def write_settings(outside: Outside, folder: Path, port: int, lease: str, **changes: Any) -> Path:
    """The settings file and secrets, as the platform chart mounts them."""
    for name, text in {
        "forge/username": "manager", "forge/password": outside.password,
        "argocd/username": "manager", "argocd/password": "x", "hook/secret": "s",
        "webhook/secret": outside.webhook_secret,
    }.items():  # fmt: skip
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    document = {
        "listen": {"address": "127.0.0.1", "port": port},
        "log_level": "info",
        "forge": {
            "url": outside.forge_url, "credentials": f"{folder}/forge", "deployment": "robotkube/deployment",
            "catalogue": "robotkube/catalogue", "branch": "main",
        },
        "oci_registry": {"charts": outside.charts_url},
        "evidence": {"keys": str(outside.keys)},
        "argocd": {
            "url": outside.nowhere, "credentials": f"{folder}/argocd", "namespace": "argocd",
            "project": "robotkube-apps",
        },
        "hook": {"url": f"{outside.nowhere}/api/webhook", "secret": f"{folder}/hook/secret"},
        "webhook": {"secret": f"{folder}/webhook/secret"},
        "lease": {"namespace": "argocd", "name": lease},
        "agents": [{"name": n, "role": r, "namespace": n, "records": r == "cloud"} for n, r in AGENTS],
        "scope": EVERYTHING,
        "operators": [],
        "node_lost_seconds": 40,
        **({"gate": {"objects": outside.objects_url}} if outside.objects_url else {}),
        **changes,
    }  # fmt: skip
    (folder / "config.yaml").write_text(yaml.safe_dump(document))
    return folder / "config.yaml"


class Pod:
    """The process and its pages. `point` (`<kill|stop> <before|after> <write>`) ends or stops it there; `hit` says
    whether it got there."""

    def __init__(self, config: Path, kubeconfig: Path, port: int, name: str, point: str = "") -> None:
        folder = config.parent
        folder.mkdir(parents=True, exist_ok=True)
        environment = {
            **os.environ, "ROBOTKUBE_CONFIG": str(config), "KUBECONFIG": str(kubeconfig), "HOME": str(folder),
            "ROBOTKUBE_WORK": str(folder / "work"), "POD_NAME": name,
        }  # fmt: skip
        self.log, self.flag = folder / "manager.log", folder / "hit"
        run = ["-m", "robotkube.delivery.manager"] if not point else ["-m", __name__, point, str(self.flag)]
        with self.log.open("ab") as log:
            self.process = subprocess.Popen([sys.executable, *run], env=environment, stderr=log)
        self.url = f"http://127.0.0.1:{port}"

    @property
    def hit(self) -> bool:
        return self.flag.exists()

    def get(self, path: str) -> httpx.Response | None:
        assert self.process.poll() is None, self.log.read_text()[-5000:]
        try:
            return http_calls.get(f"{self.url}{path}", timeout=2)
        except httpx.HTTPError:
            return None

    def ready(self) -> bool:
        answer = self.get("/readyz")
        return answer is not None and answer.is_success

    def plans(self) -> list[dict[str, Any]]:
        """Those of the process that leads; none while nobody does."""
        answer = self.get("/plans")
        assert answer is not None
        return list(answer.json()["plans"]) if answer.is_success else []

    def end(self) -> int:
        self.process.send_signal(signal.SIGTERM)
        try:
            return self.process.wait(END_SECONDS_MAX)
        finally:
            self.kill()

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(END_SECONDS_MAX)


def conditions(task: Mapping[str, Any]) -> dict[str, tuple[str, str]]:
    """Type -> status and reason."""
    return {c["type"]: (c["status"], c["reason"]) for c in task.get("status", {}).get("conditions", [])}


def ended_at(point: str, flag: Path) -> None:
    """Change the method that `point` names so that the process ends or stops there, the first time."""
    how, when, name = point.split(" ")
    module_name, class_name, method_name = name.rsplit(".", 2)
    owner = getattr(importlib.import_module(module_name), class_name)
    original: Callable[..., Any] = getattr(owner, method_name)

    def end() -> None:
        if not flag.exists():
            flag.write_text(json.dumps({"pid": os.getpid(), "point": point}))
            os.kill(os.getpid(), SIGNALS[how])

    @functools.wraps(original)
    def ending(*arguments: Any, **further: Any) -> Any:
        if when == "before":
            end()
            return original(*arguments, **further)
        result = original(*arguments, **further)
        end()
        return result

    setattr(owner, method_name, ending)


if __name__ == "__main__":
    from robotkube.delivery.manager.__main__ import GRACE_SECONDS, body
    from robotkube.foundation.runtime.process import run

    ended_at(sys.argv[1], Path(sys.argv[2]))
    run("manager", body, grace_seconds=GRACE_SECONDS)
