"""Random tasks: each is accepted, or refused with a reason; nothing crashes, and no answer is long."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.manager.loops.task_status import MESSAGE_CHARACTERS_MAX
from robotkube.delivery.tasks.core.task_description import PROBLEM_CHARACTERS_MAX, PROBLEMS_MAX, REASONS
from tests.stages.delivery.manager.manager_in_memory import Stage
from tests.stages.delivery.tasks.random_tasks import random_task
from tests.stages.examples import EXAMPLES

STATUS_CHARACTERS_MAX = 8 * MESSAGE_CHARACTERS_MAX
AT_ONCE = 20


def answered(stage: Stage, numbers: range) -> list[dict[str, Any]]:
    """The statuses of these cases after the manager has decided about all of them together."""
    keys = []
    for number in numbers:
        document = random_task(number)
        document["metadata"]["name"] = name = f"random-{number}"
        stage.tasks.objects[f"cloud-0/{name}"] = document
        keys.append(f"cloud-0/{name}")
    stage.settle()
    statuses = [stage.tasks.objects[key]["status"] for key in keys]
    for key in keys:
        stage.tasks.delete(key)
    stage.settle()
    return statuses


def try_tasks(stage: Stage, numbers: range) -> dict[str, int]:
    """How often each reason was given; every status is short and says why."""
    before = stage.releases()
    reasons: dict[str, int] = {}
    for begin in range(numbers.start, numbers.stop, AT_ONCE):
        for status in answered(stage, range(begin, min(begin + AT_ONCE, numbers.stop))):
            accepted = next(c for c in status["conditions"] if c["type"] == "Accepted")
            assert accepted["reason"] in REASONS["Accepted"]
            assert accepted["message"]
            assert (accepted["status"] == "True") == (accepted["reason"] == "Accepted")
            assert len(json.dumps(status, allow_nan=False)) <= STATUS_CHARACTERS_MAX
            reasons[accepted["reason"]] = reasons.get(accepted["reason"], 0) + 1
    after = stage.releases()
    assert {path: r.values for path, r in after.items()} == {path: r.values for path, r in before.items()}
    assert stage.manager.reasons_not_ready() == []
    return reasons


def test_random_tasks(stage: Stage) -> None:
    tasks = max(EXAMPLES, 40)  # of fewer all are refused for one reason
    reasons = try_tasks(stage, range(tasks))
    assert reasons["InvalidParameters"] > tasks // 2
    assert len(reasons) >= 2


@pytest.mark.thorough
def test_5000_more_random_tasks(tmp_path: Path) -> None:
    stage = Stage(tmp_path)
    stage.settle()
    reasons = try_tasks(stage, range(200, 5200))
    assert sum(reasons.values()) == 5000
    assert PROBLEMS_MAX * PROBLEM_CHARACTERS_MAX < 2 * MESSAGE_CHARACTERS_MAX
