"""A test namespace on this machine: charts' processes, broker, database and observer run, without a cluster."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.measuring import pods
from robotkube.registry.suites.ports.suites import Object, PodEnd, PodRun, SuiteAccount
from robotkube.testing.api_server import ApiServerInMemory
from tests.stages.commands import local_command
from tests.stages.paths import SOURCE
from tests.stages.recording.database_server import NAME, DatabaseServer
from tests.stages.ros.ros_domains import domain as ros_domain

CLAIMS = ("/var/lib/robotkube/bags", "/var/lib/robotkube/recordings", "/var/lib/robotkube/scratch")
DATABASE = "suite"
READY_SECONDS_MAX, STOP_SECONDS_MAX = 60.0, 5.0
SETTINGS = """
listener {port} 127.0.0.1
allow_anonymous false
password_file {folder}/passwords
persistence false
log_dest stderr
log_type all
user root
"""


class LocalTestNamespace:
    """The port SuiteNamespace. A Deployment's pod is one process with its ConfigMap as a folder; `/etc/robotkube` in
    its files is that folder, and the places of volume claims are one other. `server` is a running database."""

    namespace = "suite"
    agent = "cloud-0"
    seconds_left = 600.0

    def __init__(self, folder: Path, server: DatabaseServer | None = None) -> None:
        self.folder = folder
        self.domain_id = int(ros_domain())
        self.api = ApiServerInMemory()
        self.api.__enter__()
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.deployments: dict[str, Object] = {}
        self.ports: dict[str, int] = {}
        self.deleted: list[str] = []
        self._broker: SuiteAccount | None = None
        self._database: SuiteAccount | None = None
        self._server = server
        self._runs = 0
        (folder / "scratch").mkdir(parents=True)

    def close(self) -> None:
        """End everything."""
        for process in self.processes.values():
            process.kill()
            process.wait(STOP_SECONDS_MAX)
        self.api.__exit__(None, None, None)

    def provide(self, config_maps: Mapping[str, Mapping[str, str]]) -> None:
        for name, data in config_maps.items():
            self.api.put_config_map(self.namespace, name, dict(data))

    def apply(self, objects: Sequence[Object]) -> None:
        for item in objects:
            if item["kind"] == "ConfigMap":
                place = self.folder / item["metadata"]["name"]
                place.mkdir(exist_ok=True)
                data = {name: self._placed(text, place) for name, text in item["data"].items()}
                self.api.put_config_map(self.namespace, item["metadata"]["name"], data)
                for name, text in data.items():
                    (place / name).write_text(text)
        for item in objects:
            name = item["metadata"]["name"]
            if item["kind"] == "Deployment" and (item != self.deployments.get(name) or name not in self.processes):
                self._stop(self.processes.pop(name, None))
                self._start(name, item["spec"]["template"]["spec"]["containers"][0]["command"])
                self.deployments[name] = item

    def _start(self, name: str, command: Sequence[str]) -> None:
        place = self.folder / name
        self.ports[name] = pods.free_port()
        words = [self._placed(word, place) for word in local_command(command)]
        environment = self._environment(
            ROBOTKUBE_CONFIG=str(place / "config.yaml"),
            ROBOTKUBE_CONFIGMAP=f"{self.namespace}/{name}",
            ROBOTKUBE_API_SERVER=self.api.url,
            ROBOTKUBE_HEALTH_PORT=str(self.ports[name]),
            ROBOTKUBE_RECORDINGS=str(self.folder / "scratch"),
            NODE_NAME=self.agent,
        )
        self._run(name, words, environment)

    def _placed(self, text: str, place: Path) -> str:
        for claim in CLAIMS:
            text = text.replace(claim, str(self.folder / "scratch"))
        return text.replace("/etc/robotkube", str(place))

    def _run(self, name: str, command: Sequence[str], environment: Mapping[str, str]) -> None:
        with (self.folder / f"{name}.log").open("ab") as log:
            self.processes[name] = subprocess.Popen(command, env=dict(environment), stdout=log, stderr=log)

    def _environment(self, **more: str) -> dict[str, str]:
        return {
            **os.environ,
            "ROS_DOMAIN_ID": str(self.domain_id),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": str(self.folder / "ros"),
            "PYTHONPATH": str(SOURCE),
            "PYTHONSAFEPATH": "1",  # as in the images
            "ROBOTKUBE_SECRETS": str(self.folder / "secrets"),
            **more,
        }

    def wait_ready(self, kind: str, name: str, seconds: float) -> str:
        end = time.monotonic() + min(seconds, READY_SECONDS_MAX)
        while time.monotonic() < end and self.processes[name].poll() is None:
            try:
                urllib.request.urlopen(f"http://127.0.0.1:{self.ports[name]}/readyz", timeout=1).close()
            except (OSError, urllib.error.URLError):
                time.sleep(0.05)
            else:
                return ""
        return f"{kind} {name} was not ready: {self.logs(name)}"

    def delete(self, objects: Sequence[Object], seconds: float) -> Sequence[PodEnd]:
        names = [item["metadata"]["name"] for item in objects if item["kind"] == "Deployment"]
        for name in names:
            self.deleted.append(name)
            self._stop(self.processes.pop(name, None))
        return [PodEnd(name, 0.0, seconds, {name: 0}) for name in names]

    def _stop(self, process: subprocess.Popen[bytes] | None) -> None:
        if process is None:
            return
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(STOP_SECONDS_MAX)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(STOP_SECONDS_MAX)

    def pods(self) -> Sequence[Object]:
        return [self._pod(name, process.poll()) for name, process in self.processes.items()]

    def _pod(self, name: str, code: int | None) -> Object:
        state = {"running": {}} if code is None else {"terminated": {"exitCode": code, "reason": "Error"}}
        ready = {"type": "Ready", "status": str(code is None)}
        status = {"conditions": [ready], "containerStatuses": [{"name": name, "state": state}]}
        return {"metadata": {"name": name, "uid": str(self.processes[name].pid)}, "spec": {}, "status": status}

    def logs(self, pod: str) -> str:
        return (self.folder / f"{pod}.log").read_text()

    def run_pod(
        self,
        name: str,
        image: str,
        command: Sequence[str],
        files: Mapping[str, bytes],
        seconds: float,
        volume_claim: bool = False,
        accounts: bool = False,
    ) -> PodRun:
        self._runs += 1
        place = self.folder / f"{name}-{self._runs}"
        place.mkdir()
        for file, data in files.items():
            (place / file).write_bytes(data)
        environment = self._environment(ROBOTKUBE_SUITE_CONFIG=str(place / "config.json"))
        try:
            done = subprocess.run(
                [self._placed(word, place) for word in local_command(command)],
                env=environment,
                capture_output=True,
                timeout=seconds,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            return PodRun(str(error.stdout), None, "it did not end in its time")
        return PodRun((done.stdout + done.stderr).decode(), done.returncode)

    def start_broker(self) -> SuiteAccount:
        if self._broker is None:
            port = pods.free_port()
            self._broker = SuiteAccount("suite", "a password", "127.0.0.1", port)
            self._secret("broker", self._broker)
            (self.folder / "mosquitto.conf").write_text(SETTINGS.format(port=port, folder=self.folder))
            (self.folder / "passwords").touch(mode=0o600)
            words = ["mosquitto_passwd", "-b", str(self.folder / "passwords"), "suite", "a password"]
            subprocess.run(words, check=True, capture_output=True, timeout=10)
            self._run("broker", ["mosquitto", "-c", str(self.folder / "mosquitto.conf")], os.environ)
            self._await_port(port)
        return self._broker

    def _await_port(self, port: int) -> None:
        end = time.monotonic() + 10
        while time.monotonic() < end:
            try:
                socket.create_connection(("127.0.0.1", port), 1).close()
            except OSError:
                time.sleep(0.02)
            else:
                return
        raise AssertionError(f"no broker: {self.logs('broker')}")

    def start_database(self) -> SuiteAccount:
        assert self._server is not None, "this test namespace has no database"
        if self._database is None:
            self._server.create_account(DATABASE, "a password", DATABASE)
            proof: tuple[str, str] = ("", "")
            more = {"authenticationDatabase": DATABASE}
            if self._server.issued is not None:
                proof = (NAME, self._server.issued.authority)
                more |= {"tls": "required", "ca.crt": self._server.issued.authority}
            self._database = SuiteAccount(DATABASE, "a password", "127.0.0.1", self._server.port, DATABASE, *proof)
            self._secret("database", self._database, **more)
        return self._database

    def _secret(self, name: str, account: SuiteAccount, **more: str) -> None:
        place = self.folder / "secrets" / name
        place.mkdir(parents=True)
        for key, value in {**vars(account), **more}.items():
            (place / key).write_text(str(value))

    def broker_log(self) -> str:
        return self.logs("broker") if self._broker else ""

    def leftovers(self) -> list[str]:
        return sorted(set(self.processes) - {"broker"})


def deployment(name: str, command: Sequence[str], data: Mapping[str, str], secret: str = "") -> list[dict[str, Any]]:
    """What the library chart gives, as far as a local test namespace reads it."""
    volumes = [{"name": "account", "secret": {"secretName": secret}}] if secret else []
    spec = {"containers": [{"name": name, "command": list(command)}], "volumes": volumes}
    return [
        {"apiVersion": "v1", "kind": "ConfigMap", "metadata": {"name": name}, "data": dict(data)},
        {
            "apiVersion": "apps/v1",
            "kind": "Deployment",
            "metadata": {"name": name},
            "spec": {"template": {"spec": spec}},
        },
    ]
