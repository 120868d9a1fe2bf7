"""Main's releases as they run on robots, without a cluster: a process for each pod, a ROS domain for each agent, one
broker whose rights follow main, and a server for ConfigMaps and tasks."""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from benchmarks.measuring import pods
from robotkube.delivery.deployment.core.releases import Release
from robotkube.robots.ros.core.common_messages import STAMPED_TYPES
from robotkube.testing.api_server import ApiServerInMemory
from scenarios.generator import messages
from scenarios.runner.platform import listening
from tests.stages.delivery.manager.manager_in_memory import Stage
from tests.stages.delivery.rights.kept_rights import KeptRights
from tests.stages.delivery.rights.rights_broker import password
from tests.stages.paths import REPOSITORY
from tests.stages.platform.table_one import PUBLISH, Message
from tests.stages.ros.ros_domains import domain

LISTEN_SECONDS_MAX = 30
SPEAK_SECONDS_MAX = 120
MODULES = {
    "mqtt-bridge": "robotkube.robots.bridge",
    "event-detector": "robotkube.robots.detector",
    "object-detection": "robotkube.robots.perception.object_detection",
    "object-tracking": "robotkube.robots.perception.object_tracking",
}


def settings_of(release: Release) -> dict[str, Any]:
    """What the release's chart writes into `config.yaml`."""
    if release.chart == "mqtt-bridge":
        return {"agent": release.values["placement"]["agent"], **release.values["bridge"]}
    if release.chart == "event-detector":
        return {"name": release.key, **release.values["detector"]}
    word = release.chart.removeprefix("object-")
    defaults = yaml.safe_load((REPOSITORY / "charts" / "apps" / release.chart / "values.yaml").read_text())
    return {**defaults[word], **release.values[word]}


@dataclass
class Running:
    """A release's process, and its log."""

    pod: pods.Pod
    log: Path


class RunningReleases:
    """The releases of `agents` on the manager's main; `follow` brings the processes to what main says now."""

    def __init__(self, folder: Path, manager: Stage, agents: tuple[str, ...]) -> None:
        self.folder, self.manager, self.agents = folder, manager, agents
        self.api = ApiServerInMemory()
        self.running: dict[str, Running] = {}
        (folder / "broker").mkdir()
        self.rights = KeptRights(folder / "broker")

    def follow(self) -> None:
        """Rights, settings and processes are main's."""
        releases = self.manager.releases().values()
        self.rights.merge(*releases)
        wanted = {one.key: one for one in releases if one.namespace in self.agents}
        for key in self.running.keys() - wanted.keys():
            self.running.pop(key).pod.stop()
        for key, release in wanted.items():
            text = json.dumps(settings_of(release))
            self.api.put_config_map(release.namespace, release.name, {"config.yaml": text})
            if key not in self.running:
                self.running[key] = self._start(release, text)

    def tasks(self, namespace: str) -> dict[str, Any]:
        """The tasks that operators of a namespace have given, by name."""
        given = self.api.objects(f"/apis/robotkube.io/v1alpha1/namespaces/{namespace}/taskdescriptions")
        return {one["metadata"]["name"]: one for one in given}

    @contextmanager
    def publishing(self, agent: str, *published: Message, hertz: float = 5) -> Iterator[None]:
        """Messages said on an agent as if its sensor did, again and again, stamped with the present time."""
        lines = [
            (topic, kind, base64.b64encode(data).decode(), kind in STAMPED_TYPES) for topic, kind, data in published
        ]
        command = ["python3", "-c", PUBLISH, str(hertz), str(SPEAK_SECONDS_MAX)]
        process = subprocess.Popen(
            _here(command), env=self._environment(agent), stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
        )
        assert process.stdin is not None
        try:
            process.stdin.write(json.dumps(lines) + "\n")
            process.stdin.flush()
            yield
            assert process.poll() is None, f"the publisher of {agent} ended with {process.returncode}"
        finally:
            process.stdin.close()
            process.wait(LISTEN_SECONDS_MAX)

    def receive(self, agent: str, topic: str, kind: str, count: int = 1) -> list[Any]:
        """`count` messages that are heard on an agent; fails when there are fewer."""
        command = _here(listening.arguments(topic, kind, count, LISTEN_SECONDS_MAX))
        done = subprocess.run(
            command, env=self._environment(agent), capture_output=True, text=True, timeout=60, check=False
        )
        heard = listening.messages(done.stdout)
        assert len(heard) >= count, f"{topic}: {len(heard)} of {count} messages\n{done.stderr[-2000:]}\n{self.logs()}"
        return [messages.store.deserialize_cdr(data, kind) for data in heard[:count]]

    def logs(self) -> str:
        """The end of what each process said."""
        return "\n".join(f"{key}:\n{one.log.read_text()[-1500:]}" for key, one in self.running.items())

    def close(self) -> None:
        """Everything ends."""
        for one in self.running.values():
            one.pod.process.terminate()
        for one in self.running.values():
            one.pod.stop()
        self.rights.end()
        self.rights.broker.stop()

    def _start(self, release: Release, text: str) -> Running:
        folder = self.folder / release.key
        port = pods.free_port()
        folder.mkdir(parents=True)
        (folder / "config.yaml").write_text(text)
        environment = {
            **self._environment(release.namespace),
            "HOSTNAME": f"{release.name}-1",
            "ROBOTKUBE_API_SERVER": self.api.url,
            "ROBOTKUBE_CONFIG": str(folder / "config.yaml"),
            "ROBOTKUBE_CONFIGMAP": release.key,
            "ROBOTKUBE_HEALTH_PORT": str(port),
            "ROBOTKUBE_REACTIONS": str(folder),
            "ROBOTKUBE_SECRETS": str(self._account(release.namespace)),
        }
        log = folder / "log"
        return Running(pods.start(release.key, pods.python(MODULES[release.chart]), environment, log), log)

    def _account(self, agent: str) -> Path:
        folder = self.folder / "secrets" / agent / "broker"
        folder.mkdir(parents=True, exist_ok=True)
        port = str(self.rights.broker.port)
        values = {"username": agent, "password": password(agent), "host": "127.0.0.1", "port": port}
        for key, value in values.items():
            (folder / key).write_text(value)
        return folder.parent

    def _environment(self, agent: str) -> dict[str, str]:
        return {
            **os.environ,
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_DOMAIN_ID": domain(agent),
            "ROS_LOG_DIR": str(self.folder / "ros"),
            "PYTHONPATH": os.pathsep.join(sys.path),
        }


def _here(command: list[str]) -> list[str]:
    """A command of Python's with this interpreter."""
    return [sys.executable, *command[1:]]
