"""A plan's pull request as a person sees it in a browser, on a forge with what `make web` has built."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from ci import console, web
from ci.images.catalogue import BY_NAME, Sources, go_module
from ci.images.contexts import assemble
from robotkube.testing.clusters import MemoryTasks
from tests.stages import http_calls
from tests.stages.delivery.manager.running_manager import RunningManager, start_manager
from tests.stages.forge.fixtures import installed
from tests.stages.forge.gitea import ForgeProcess
from tests.stages.forge.installation import VIEWER, ApplicationSetController, Installation, start_gate
from tests.stages.paths import REPOSITORY
from tests.stages.waiting import until

pytestmark = [pytest.mark.toolchain, pytest.mark.thorough]

PICTURES = REPOSITORY / "build" / "pictures"
KEY = "cloud-0/meeting"
TASK = {
    "requester": "cloud-0/event-detector",
    "event": {"rule": "lidar-proximity", "id": "3f2a9c", "trace": "1e3" + "0" * 29, "time": "2026-11-21T10:00:00Z"},
    "reason": "vehicle-00, vehicle-01 within 400 m",
    "application": "pose-point-cloud-recording",
    "parameters": {"vehicles": ["vehicle-00", "vehicle-01"]},
}


@pytest.fixture(scope="module")
def installation(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Installation]:
    """On a forge with the files that its image has."""
    context = tmp_path_factory.mktemp("context")
    contents = BY_NAME["gitea"].contents(Sources(context, go_module, lambda: context, web.build()))
    assemble(tuple(copied for copied in contents if copied.target.startswith("share/")), context)
    process = ForgeProcess(tmp_path_factory.mktemp("forge"), static=context / "share" / "gitea")
    with installed(process, tmp_path_factory.mktemp("clones")) as made:
        yield made


@pytest.fixture(scope="module")
def manager(installation: Installation, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningManager]:
    """With a plan for a task, which the gate has merged."""
    controller = ApplicationSetController()
    gate = start_gate(installation, controller.url, tmp_path_factory.mktemp("gate"))
    started = start_manager(installation, tmp_path_factory.mktemp("manager"), MemoryTasks())
    until(lambda: started.manager.reasons_not_ready() == [], "ready")
    started.tasks.create("cloud-0", "meeting", TASK)
    until(lambda: started.tasks.condition(KEY, "Committed") == ("True", "Merged"), "committed")
    yield started
    started.stop()
    gate.stop()
    controller.stop()


@pytest.fixture(scope="module")
def seen(installation: Installation, manager: RunningManager) -> Mapping[str, Any]:
    """What a browser has read of the plan's pull request, and of the list of them, as the viewer."""
    number = manager.tasks.objects[KEY]["status"]["pullRequest"]["number"]
    until(lambda: installation.pull_request(number)["merged"], "marked merged by the forge")
    account = (VIEWER, installation.passwords[VIEWER])
    said: Mapping[str, Any] = json.loads(console.browse("plan", installation.url, *account, str(number), str(PICTURES)))
    return said


def test_reasons_and_evidence_of_a_plan_are_seen(seen: Mapping[str, Any]) -> None:
    request = seen["request"]
    assert "deploy(recording): vehicle-00, vehicle-01 within 400 m" in request["words"]
    assert request["headings"] == ["Asked", "Decided", "Changes", "Evidence"]
    asked = "cloud-0/meeting asks for pose-point-cloud-recording (rule lidar-proximity, event 3f2a9c)"
    assert asked in request["words"]
    assert any("event-detector 0.2.3: passed" in line and "summary sha256:" in line for line in request["lines"])
    assert "gate manually merged commit" in request["words"]
    assert "releases/cloud-0/recorder-vehicle-00-vehicle-01.yaml" in seen["files"]
    assert seen["failures"] == []


def test_the_pages_have_what_they_load(installation: Installation, seen: Mapping[str, Any]) -> None:
    """And it is by that that the command line knows whether they were built."""
    assert http_calls.get(f"{installation.url}/assets/licenses.txt").status_code == 200
    assert min(seen["rules"]) > 0
    assert sum(seen["rules"]) > 1000
    assert seen["drawings"] > 0
