"""`ci/python -m tests.stages.console.console_process PAGE [--agents N] [--releases M]`: the console over HTTP as its
process has it, with the page in the folder PAGE, over a read model that a synthetic fleet fills: poses of each agent at
2 Hz, and an event every second, which begins when it is put there.

Prints its address; ends when its input does, with a last line: `cpu_share`, of one core, without what making the fleet
took.
"""

from __future__ import annotations

import argparse
import json
import sys
import threading
import time
from itertools import islice
from pathlib import Path

from robotkube.delivery.console.adapters.web.application import Console, ConsoleSurroundings
from robotkube.delivery.console.adapters.web.page_files import read_files
from robotkube.delivery.console.adapters.web.people import People
from robotkube.delivery.console.adapters.web.server import AsgiServer
from robotkube.delivery.console.core import table as kinds
from robotkube.delivery.console.loops.model import ReadModel
from tests.delivery.console.people import PlatformInMemory
from tests.stages.console.synthetic import STEP_MS, Fleet

EVENT_SECONDS = 1.0
TASKS = 30  # and plans: of as many events as the fleet's view lists


def now_ms() -> int:
    return time.time_ns() // 1_000_000


class Feeding:
    """A thread that writes the fleet's poses and events into the model. `made_seconds`: processor time of making them,
    which the real process spends elsewhere."""

    def __init__(self, model: ReadModel, fleet: Fleet) -> None:
        self.model, self.fleet = model, fleet
        self.made_seconds = 0.0
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="fleet", daemon=True)

    def start(self) -> None:
        """Fills the model, and goes on changing it."""
        items = self.fleet.snapshot(now_ms() // STEP_MS)["items"]
        for kind in kinds.KINDS:
            if kind not in (kinds.SOURCES, kinds.EVENTS) and items.get(kind):
                most = TASKS if kind in (kinds.TASKS, kinds.PLANS) else None
                self.model.replace(kind, dict(islice(items[kind].items(), most)))
        self.model.put_source("broker", "", "", (kinds.POSES,))
        self._thread.start()

    def stop(self) -> None:
        """Ends."""
        self._ending.set()
        self._thread.join(5)

    def _run(self) -> None:
        event_due = time.monotonic()
        number = 0
        while not self._ending.wait(STEP_MS / 1000 - time.time() % (STEP_MS / 1000)):
            began = time.thread_time()
            poses = self.fleet.poses(now_ms() // STEP_MS)
            self.made_seconds += time.thread_time() - began
            for name, pose in poses.items():
                self.model.put(kinds.POSES, name, pose)
            if time.monotonic() >= event_due:
                event_due += EVENT_SECONDS
                number += 1
                self._event(number)

    def _event(self, number: int) -> None:
        began = now_ms()
        event = self.fleet.event(number, began, began, began)
        self.model.put(kinds.EVENTS, event["id"], event | {"began_ms": now_ms()})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("page", type=Path)
    parser.add_argument("--agents", type=int, default=15)
    parser.add_argument("--releases", type=int, default=60)
    arguments = parser.parse_args()
    model = ReadModel("measured", now_ms)
    feeding = Feeding(model, Fleet(arguments.agents, arguments.releases))
    feeding.start()
    around = ConsoleSurroundings(["localhost"], files=read_files(arguments.page))
    console = Console(model, People(None), PlatformInMemory().asking, around)
    server = AsgiServer(console.app, "127.0.0.1", 0)
    server.start()
    began = time.monotonic()
    spent = time.process_time()
    made = feeding.made_seconds
    print(f"http://localhost:{server.port}/", flush=True)
    sys.stdin.read()
    used = time.process_time() - spent - (feeding.made_seconds - made)
    print(json.dumps({"cpu_share": round(used / (time.monotonic() - began), 4)}), flush=True)
    feeding.stop()
    console.streams.stop()
    server.stop()


if __name__ == "__main__":
    main()
