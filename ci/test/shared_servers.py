"""Which files of tests share servers that run until the session ends, and a pytest plugin that keeps them together.

Each process of a run starts such a server for itself when its first test asks for it: an API server takes 2 s of a
processor to start and 540 MB of memory, a forge 1.3 s and 210 MB. So files that share servers come last, and a process
that is free takes one whose servers it runs already, or one of a server that nobody runs yet, before it starts a second
one.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

import pytest
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController

FIXTURES = {
    "API server": re.compile(r"\b(api_server: |api: Api\b)"),
    "API server under policies": re.compile(r"\bunder_policies: "),
    "API server of the agents": re.compile(r"\bmanager_api: Api\b"),
    "forge": re.compile(
        r"\b((shared_)?installation: Installation\b|gate: RunningGate\b|(administration|forge_process): )"
    ),
}
"""Words with which a file's tests ask for a server, by its name."""
OF_ITS_OWN = re.compile(r"^def api\(", re.MULTILINE)
"""In a file whose `api` is a fixture of its own, which says itself for what it asks."""


@cache
def servers_of(file: Path) -> frozenset[str]:
    """The shared servers for which tests of a file ask; none when it is no file."""
    text = file.read_text("utf-8") if file.is_file() else ""
    if OF_ITS_OWN.search(text):
        text = text.replace("api: Api", "api")
    return frozenset(name for name, words in FIXTURES.items() if words.search(text))


def next_of(waiting: Mapping[str, frozenset[str]], own: frozenset[str], others: Iterable[frozenset[str]]) -> str:
    """The file that a process takes next: of those that are `waiting`, each with its servers, the first for which it
    starts the fewest that others run, and of these the first for which it starts the fewest."""
    running = frozenset[str]().union(*others)

    def cost(file: str) -> tuple[int, int]:
        started = waiting[file] - own
        return len(started & running), len(started)

    return min(waiting, key=cost)


class KeptTogether(LoadFileScheduling):  # type: ignore[misc]
    """Gives whole files to processes, as `loadfile` does, in the order of `next_of`."""

    def _assign_work_unit(self, node: WorkerController) -> None:
        servers = {other: self._servers(files) for other, files in self.assigned_work.items()}
        others = [of_other for other, of_other in servers.items() if other is not node]
        waiting = {file: self._servers([file]) for file in self.workqueue}
        chosen = next_of(waiting, servers.get(node, frozenset()), others)
        self.workqueue.move_to_end(chosen, last=False)
        super()._assign_work_unit(node)

    def _servers(self, files: Iterable[str]) -> frozenset[str]:
        return frozenset[str]().union(*(servers_of(self.config.rootpath / file) for file in files))


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> KeptTogether:
    return KeptTogether(config, log)
