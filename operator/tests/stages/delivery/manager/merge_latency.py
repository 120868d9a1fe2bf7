"""Merge latencies of tasks, and times of the forge alone, over N of each: prints them as JSON, in milliseconds.

    ci/python -m tests.stages.delivery.manager.merge_latency N

`floor`: propose a one-line change by AGit and push it to main, while manager and gate stand still; half of them before
and half after the tasks, since repository and machine are not the same at both times. `tasks`: from a task's creation
to the manager's knowing that its plan is on main. `checks`: what the gate's checks take of that.
"""

from __future__ import annotations

import json
import logging
import re
import secrets
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from robotkube.delivery.manager.__main__ import changed_by
from robotkube.delivery.manager.loops.reconciler import TASKS
from robotkube.foundation.forge.adapters.git import GitClone, ProposalWriter
from robotkube.foundation.runtime.adapters.webhook_server import WebServer
from robotkube.setup.adapters.gitea_administration import GiteaAdministration
from robotkube.setup.loops.bootstrap import Bootstrap
from robotkube.testing.clusters import MemoryTasks
from tests.stages.delivery.manager.running_manager import RunningManager, start_manager
from tests.stages.forge.gitea import ForgeProcess
from tests.stages.forge.installation import (
    ACCOUNTS,
    ApplicationSetController,
    Installation,
    forge_setup,
    manager_secret,
    start_gate,
)
from tests.stages.programs import free_port

WARMING_UP = 3
WAIT_SECONDS_MAX = 60.0
POLL_SECONDS = 0.002
REPOSITORY = "robotkube/deployment"
VEHICLES = ["vehicle-00", "vehicle-01"]


def until(condition: Callable[[], object], what: str, seconds_max: float = WAIT_SECONDS_MAX) -> None:
    """Wait until it is true; polls often, since what it waits for is being measured."""
    end = time.monotonic() + seconds_max
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"not within {seconds_max:.0f} s: {what}")
        time.sleep(POLL_SECONDS)


class CheckTimes(logging.Handler):
    """Durations of the gate's checks by its log, in milliseconds."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.milliseconds: list[float] = []

    def emit(self, record: logging.LogRecord) -> None:
        match = re.search(r"check_ms=(\d+\.\d+)", record.getMessage())
        if match:
            self.milliseconds.append(float(match[1]))


class Stage:
    """A forge with everything on it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.process = ForgeProcess(folder / "forge")
        self.process.start()
        self.controller = ApplicationSetController()
        passwords = {account: secrets.token_hex(12) for account in ACCOUNTS}
        gate_port, self.manager_port = free_port(), free_port()
        setup = forge_setup(passwords, f"http://127.0.0.1:{gate_port}/webhook")
        administration = GiteaAdministration(
            self.process.url, self.process.administrator, self.process.administrator_password
        )
        Bootstrap(30, time.monotonic, time.sleep).forge(setup, administration)
        hook = f"http://127.0.0.1:{self.manager_port}/webhook"
        administration.make_webhook(REPOSITORY, hook, ("push", "pull_request"), manager_secret())
        administration.disconnect()
        self.installation = Installation(self.process.url, passwords, gate_port, folder, setup)

    def close(self) -> None:
        self.installation.disconnect()
        self.controller.stop()
        self.process.remove()

    def floor(self, name: str, count: int) -> list[float]:
        """Milliseconds of each proposal and push, with nobody else on the forge. `name`: of the changes."""
        url, passwords = self.installation.url, self.installation.passwords
        clone = GitClone(url, REPOSITORY, "gate", passwords["gate"], self.folder / name)
        writer = ProposalWriter(self.folder / name, "manager", passwords["manager"], name, time.time)
        tip = clone.fetch()
        milliseconds = []
        for number in range(WARMING_UP + count):
            commit = writer.commit(tip, {"README.md": f"{name} {number}\n"}, f"{name} {number}\n")
            began = time.perf_counter()
            writer.propose(commit, f"{name}-{number}", name, "one line")
            if not clone.push_main(commit):
                raise AssertionError("somebody else moved main")
            milliseconds.append(1000 * (time.perf_counter() - began))
            tip = commit
        return milliseconds[WARMING_UP:]

    def plans(self, count: int) -> tuple[list[float], list[float]]:
        """Milliseconds from a task to its plan on main, and of the gate's checks."""
        times = CheckTimes()
        logger = logging.getLogger("robotkube.delivery.gate.loops.gate")
        logger.addHandler(times)
        logger.setLevel(logging.INFO)
        managers = [f"http://127.0.0.1:{self.manager_port}/webhook"]
        gate = start_gate(self.installation, self.controller.url, self.folder / "gate", managers=managers)
        running = start_manager(self.installation, self.folder / "manager", MemoryTasks())
        server = self._listen(running)
        try:
            until(lambda: running.plans() and running.plans()[-1]["on_main"], "initial configuration on main")
            latencies = [one_task(running, number) for number in range(WARMING_UP + count)]
        finally:
            logger.removeHandler(times)
            server.stop()
            running.stop()
            gate.stop()
        return latencies[WARMING_UP:], times.milliseconds[-2 * count :]

    def _listen(self, running: RunningManager) -> WebServer:
        """The manager's webhook, as its entry point wires it."""

        def deliver(delivery: Any) -> None:
            if change := changed_by(delivery, "robotkube/catalogue"):
                running.manager.wake(*change)

        secret = manager_secret().encode()
        server = WebServer("127.0.0.1", self.manager_port, lambda: [], lambda: "", secret, deliver)
        server.start()
        return server


def one_task(running: RunningManager, number: int) -> float:
    """A task is created, and withdrawn when its plan is on main; milliseconds from its creation to that."""
    key = f"cloud-0/meeting-{number}"
    event = {"rule": "lidar-proximity", "id": f"e{number}", "trace": f"{number:032x}", "time": "2026-11-21T10:00:00Z"}
    spec = {
        "requester": "benchmark",
        "event": event,
        "reason": f"meeting {number}",
        "application": "pose-point-cloud-recording",
        "parameters": {"vehicles": VEHICLES},
    }
    began = time.time_ns()
    running.tasks.create("cloud-0", key.partition("/")[2], spec)
    running.manager.wake(TASKS)
    until(lambda: running.tasks.condition(key, "Committed")[0] == "True", "task committed")
    merged: int = next(plan["merged"] for plan in reversed(running.plans()) if key in plan["tasks"])
    running.tasks.delete(key)
    running.manager.wake(TASKS)
    until(lambda: running.plans()[-1]["cause"] == "withdrawal" and running.last_plan_is("merged"), "withdrawn")
    return (merged - began) / 1e6


def main(count: int) -> None:
    """Measure on a forge of its own."""
    with tempfile.TemporaryDirectory() as folder:
        stage = Stage(Path(folder))
        try:
            floor = stage.floor("before", count // 2)
            tasks, checks = stage.plans(count)
            floor += stage.floor("after", count - count // 2)
        finally:
            stage.close()
    print(json.dumps({"floor": floor, "tasks": tasks, "checks": checks}))


if __name__ == "__main__":
    main(int(sys.argv[1]))
