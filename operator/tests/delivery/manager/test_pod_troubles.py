"""What keeps a task's pods from being ready is said where it is asked: in the task's condition Ready."""

from __future__ import annotations

from typing import Any

import pytest

from robotkube.delivery.deployment.core.releases import application_name
from robotkube.delivery.manager.adapters.pod_states import WORDS_CHARACTERS_MAX, placed, read_pod
from robotkube.delivery.manager.core.pod_troubles import pod_troubles
from robotkube.delivery.manager.loops.reconciler import APPLICATIONS
from tests.stages.delivery.manager.manager_in_memory import Stage

ENDED = {"terminated": {"reason": "Error", "exitCode": 2, "finishedAt": "2026-11-26T13:46:02Z"}}
BACK_OFF = {"waiting": {"reason": "CrashLoopBackOff", "message": "back-off 20s restarting failed container"}}
NO_IMAGE = {"waiting": {"reason": "ErrImagePull", "message": "not found"}}


def pod(state: dict[str, Any], last: dict[str, Any] | None = None, restarts: int = 0, ready: bool = False) -> Any:
    status = {"name": "watch", "ready": ready, "restartCount": restarts, "state": state, "lastState": last or {}}
    labels = {"app.kubernetes.io/instance": "watch"}
    return read_pod(
        {
            "metadata": {"namespace": "vehicle-02", "name": "watch-1", "labels": labels},
            "status": {"containerStatuses": [status]},
        }
    )


@pytest.mark.parametrize(
    ("state", "last", "restarts", "words"),
    [
        (BACK_OFF, ENDED, 2, "container watch ended (Error, exit code 2), started again 2 times; its log says why"),
        (
            {"running": {}},
            ENDED,
            1,
            "container watch ended (Error, exit code 2), started again 1 time;",
        ),
        (NO_IMAGE, None, 0, "container watch cannot begin (ErrImagePull: not found)"),
    ],
)
def test_a_container_that_fails_is_named_with_its_cause(
    state: dict[str, Any], last: dict[str, Any] | None, restarts: int, words: str
) -> None:
    failing = pod(state, last, restarts)
    [said] = pod_troubles([failing])
    assert said.startswith(f"pod watch-1: {words}")
    assert placed(failing) != placed(pod({"running": {}})), "the manager hears of it at once"


def test_the_last_words_of_a_container_survive_the_cut() -> None:
    """As the kubelet has them of its termination message, or of what never began."""
    traceback = "Traceback (most recent call last):\n" + "  spin_once(node)\n" * 40 + "KeyError: 'map'\n"
    [said] = pod_troubles([pod(BACK_OFF, {"terminated": {**ENDED["terminated"], "message": traceback}}, 2)])
    assert "(Error, exit code 2), started again 2 times: Traceback (most recent call last): spin" in said
    assert said.endswith("spin_once(node) KeyError: 'map'")
    assert len(said) < 2 * WORDS_CHARACTERS_MAX
    exec_failed = {"reason": "RunContainerError", "message": "x" * 400 + ': exec: "watch": executable file not found'}
    [said] = pod_troubles([pod({"waiting": exec_failed})])
    assert said.endswith('exec: "watch": executable file not found)')


def test_what_is_on_its_way_or_ready_has_no_trouble() -> None:
    assert pod_troubles([pod({"waiting": {"reason": "ContainerCreating"}})]) == []
    assert pod_troubles([pod({"running": {}}, ENDED, 1, ready=True)]) == []


def test_the_task_says_it(stage: Stage) -> None:
    key = stage.ask()
    stage.go()
    stage.cluster.settle(stage.releases())
    release = str(stage.tasks.objects[key]["status"]["releases"][0])
    stage.cluster.worsen(application_name(*release.split("/")), "Progressing")
    stage.cluster.running[release] = [pod(BACK_OFF, ENDED, 2)]
    stage.go(wake=APPLICATIONS)
    assert stage.tasks.condition(key, "Ready") == ("False", "Progressing")
    conditions = stage.tasks.objects[key]["status"]["conditions"]
    (message,) = (condition["message"] for condition in conditions if condition["type"] == "Ready")
    said = "pod watch-1: container watch ended (Error, exit code 2), started again 2 times; its log says why"
    assert message == f"{release}: health is Progressing; {said}"
