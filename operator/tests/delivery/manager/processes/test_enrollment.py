"""A vehicle that is enrolled in mid-run, from the command line to releases on main: a real forge, the real gate, the
manager; the cluster is in memory."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from robotkube.cli.main import main
from robotkube.delivery.manager.loops.reconciler import DEPLOYMENT, TASKS
from robotkube.testing.clusters import MemoryTasks
from tests.delivery.manager.processes.test_manager import KEY, ask, committed, releases
from tests.delivery.rights.test_revoking import Person
from tests.stages.delivery.manager.running_manager import RunningManager, start_manager
from tests.stages.forge.installation import RESERVED, Installation, RunningGate
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

[NEW] = RESERVED


def test_a_vehicle_enrolled_in_mid_run_takes_part(
    installation: Installation, gate: RunningGate, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    manager = start_manager(installation, tmp_path, MemoryTasks(), reserved=[NEW])
    person = Person(installation, tmp_path)

    def by_people(*words: str) -> None:
        capsys.readouterr()
        assert main(person.words(*words)) == 0
        person.merged(json.loads(capsys.readouterr().out))
        manager.manager.wake(DEPLOYMENT)

    def runs_there() -> bool:
        return NEW in {release.namespace for release in releases(installation).values()}

    try:
        until(lambda: manager.manager.reasons_not_ready() == [], "ready")
        ask(manager.tasks, ("vehicle-00", NEW))
        manager.manager.wake(TASKS)
        until(lambda: accepted(manager) == "False", "refused: there is no such agent")
        assert not runs_there()
        by_people("enroll", NEW, "--role", "vehicle")
        until(lambda: committed(manager), "committed")
        assert runs_there()
        by_people("withdraw", NEW, "--reason", "sold")
        until(lambda: not runs_there(), "its releases go")
        assert accepted(manager) == "False"
        manager.tasks.delete(KEY)
        manager.manager.wake(TASKS)
        until(lambda: all(not release.causes for release in releases(installation).values()), "withdrawn")
    finally:
        manager.stop()


def accepted(manager: RunningManager) -> str:
    status: str = manager.tasks.condition(KEY, "Accepted")[0]
    return status
