"""A storm of demands on a real forge and a real API server, and the manager's recovery from SIGKILL.

    ci/python -m tests.stages.delivery.manager.task_storm DEMANDS NODES

Prints one JSON object: `storm_seconds` from the first demand's creation to the last one's being on main, `plans` it
took, `rss_mib` of the manager's process after so many demands on main, and `recovery_seconds` from the start of a new
process in the same pod, once the old one was killed, to its first decision. Each demand makes a release of its own; the
gate (in this process) checks every file for real. There is no Argo CD. NODES are Node objects of declared agents on the
API server, without kubelets.
"""

from __future__ import annotations

import hashlib
import json
import logging
import re
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
from prometheus_client.parser import text_string_to_metric_families

from robotkube.foundation.kubernetes.adapters.client import api_client, call
from tests.stages.delivery.manager.manager_process import AGENTS, Pod, write_settings
from tests.stages.delivery.manager.merge_latency import Stage, until
from tests.stages.forge.catalogue_evidence import published_chart
from tests.stages.forge.installation import CATALOGUE, outside, start_gate
from tests.stages.kubernetes.api_calls import TASKS, Api, prepare
from tests.stages.kubernetes.api_server import ApiServerProcess

WAIT_SECONDS_MAX = 120.0
POLL_SECONDS = 0.25
WRITERS = 4
MARKS = (100, 500)
POD = "manager-0"  # a container that is restarted keeps the name of its pod, and with it the election
DIGEST = "sha256:" + hashlib.sha256(b"bag-player").hexdigest()
APPLICATION = """apiVersion: registry.robotkube.io/v1alpha1
kind: Application
metadata: {name: storm}
spec:
  description: One release for each task
  provides: [benchmark/storm]
  parameters:
    type: object
    additionalProperties: false
    required: [number, agent]
    properties:
      number: {description: which one, type: integer}
      agent: {description: where it runs, type: string}
  services:
  - name: player
    release: "storm-{{ parameters.number }}"
    chart: {name: bag-player, version: ">=0.1.0 <0.2.0"}
    placement: {agent: "{{ parameters.agent }}"}
    values:
      player:
        agent: "{{ parameters.agent }}"
        bag: "/var/lib/robotkube/bags/{{ parameters.number }}"
        ledger: /var/lib/robotkube/bags/ledger
      bags: {claim: bags}
"""


class Storm:
    """A forge with its gate, an API server with tasks and nodes, and the manager as a process of its own."""

    def __init__(self, folder: Path, nodes: int) -> None:
        CATALOGUE.update({"applications/storm.yaml": APPLICATION, **published_chart("bag-player", "0.1.0", DIGEST)})
        self.folder = folder
        self.agents = [*AGENTS, *((f"edge-{number:04d}", "edge") for number in range(nodes))]
        self.stage = Stage(folder)
        self.server = ApiServerProcess(self._folder("api"))
        self.server.start()
        self.api = Api(api_client(str(self.server.kubeconfig)))
        prepare(self.api)
        self._make_nodes()
        managers = [f"http://127.0.0.1:{self.stage.manager_port}/webhook"]
        self.gate = start_gate(self.stage.installation, self.stage.controller.url, folder / "gate", managers=managers)
        self.config = self._settings()
        self.pod = self.start()
        until(lambda: self.pod.plans() and self.pod.plans()[-1]["on_main"], "initial configuration on main")

    def _folder(self, name: str) -> Path:
        folder = self.folder / name
        folder.mkdir(parents=True)
        return folder

    def _settings(self) -> Path:
        agents = [{"name": n, "role": role, "namespace": n, "records": role == "cloud"} for n, role in self.agents]
        connection = outside(self.stage.installation)
        return write_settings(
            connection, self._folder("manager"), self.stage.manager_port, self.api.lease(), agents=agents
        )

    def _make_nodes(self) -> None:
        with ThreadPoolExecutor(WRITERS) as pool:
            list(pool.map(lambda agent: self.api.node(*agent), self.agents))

    def start(self) -> Pod:
        """A new process of the manager on the same settings and folder."""
        pod = Pod(self.config, self.server.kubeconfig, self.stage.manager_port, POD)
        until(lambda: alive(pod), "the manager serves", WAIT_SECONDS_MAX)
        return pod

    def close(self) -> None:
        self.pod.kill()
        self.gate.stop()
        self.api.client.rest_client.pool_manager.clear()
        self.server.stop()
        self.stage.close()

    def ask(self, number: int) -> None:
        """One demand on a release of its own."""
        agent = AGENTS[number % len(AGENTS)][0]
        event = {"rule": "storm", "id": f"e{number}", "trace": f"{number + 1:032x}", "time": "2026-11-21T10:00:00Z"}
        asked = {"application": "storm", "parameters": {"number": number, "agent": agent}, "event": event}
        self.api.task(f"storm-{number}", **asked, reason=f"demand {number}")

    def committed(self) -> int:
        """The number of tasks that say that they are on main."""
        tasks = json.loads(call(self.api.client, "GET", TASKS, [("limit", "2000")]).data)["items"]
        return sum(is_committed(task) for task in tasks)

    def rss_mib(self) -> float:
        """Resident memory of the manager's process."""
        status = Path(f"/proc/{self.pod.process.pid}/status").read_text()
        match = re.search(r"VmRSS:\s+(\d+)", status)
        assert match is not None
        return int(match[1]) / 1024

    def blow(self, demands: int) -> dict[str, Any]:
        """All demands at once; what it took until they were on main."""
        marks: dict[str, float] = {}
        with ThreadPoolExecutor(WRITERS) as pool:
            began = time.monotonic()
            asked = [pool.submit(self.ask, number) for number in range(demands)]
            while (count := self.committed()) < demands:
                for mark in (mark for mark in MARKS if count >= mark):
                    marks.setdefault(str(mark), self.rss_mib())
                assert time.monotonic() - began < WAIT_SECONDS_MAX, f"{count} of {demands} on main"
                time.sleep(POLL_SECONDS)
            took = time.monotonic() - began
            for future in asked:
                future.result()
        marks[str(demands)] = self.rss_mib()
        return {"storm_seconds": took, "rss_mib": marks, "plans": len(self.pod.plans())}

    def recover(self) -> float:
        """Seconds from the start of a new process, after SIGKILL, to its first decision."""
        self.pod.kill()
        began = time.monotonic()
        self.pod = self.start()
        until(lambda: decisions(self.pod) > 0, "first decision", WAIT_SECONDS_MAX)
        return time.monotonic() - began


def alive(pod: Pod) -> bool:
    """Return whether its port answers."""
    with suppress(httpx.HTTPError):
        answer = pod.get("/livez")
        return answer is not None and answer.is_success
    return False


def is_committed(task: dict[str, Any]) -> bool:
    """Return whether the task's status says that it is on main."""
    conditions = task.get("status", {}).get("conditions", [])
    return any(condition["type"] == "Committed" and condition["status"] == "True" for condition in conditions)


def decisions(pod: Pod) -> float:
    """The number of decisions that the process has made."""
    answer = pod.get("/metrics")
    families = text_string_to_metric_families(answer.text if answer is not None else "")
    values = {sample.name: sample.value for family in families for sample in family.samples}
    return values.get("robotkube_manager_decision_seconds_count", 0.0)


@contextmanager
def storm(nodes: int) -> Iterator[Storm]:
    """Everything around one storm, taken down afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        made = Storm(Path(folder), nodes)
        try:
            yield made
        finally:
            made.close()


def main(demands: int, nodes: int) -> None:
    """Measure on a forge and an API server of its own."""
    warnings.simplefilter("ignore")
    logging.getLogger("robotkube").setLevel(logging.ERROR)
    with storm(nodes) as measured:
        result = measured.blow(demands)
        result["recovery_seconds"] = measured.recover()
    print(json.dumps(result))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
