"""A task that runs is not taken away by a mistyped parameter: `task submit` asks the manager before it changes one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import pytest

from robotkube.cli.platform import Platform
from robotkube.cli.tasks import submit
from robotkube.errors import RefusalError, UnavailableError

PRESENT = {"application": "convoy", "parameters": {"limit": 5}, "requester": "tester"}
LIMIT = "parameters.limit: 99 is greater than the maximum of 50"
REFUSED = {"outcome": "Refused", "reason": "InvalidParameters", "message": LIMIT}


class Running:
    """A platform with one task; `answer` is the manager's to /explain."""

    def __init__(self, answer: Mapping[str, Any] | None) -> None:
        self.answer, self.asked, self.changed = answer, list[Any](), list[Any]()

    def task_writer(self, dry_run: bool) -> Running:
        return self

    def create(self, document: Mapping[str, Any]) -> bool:
        return False

    def find(self, namespace: str, name: str) -> Mapping[str, Any]:
        return {"spec": PRESENT}

    def patch_spec(self, namespace: str, name: str, spec: Mapping[str, Any]) -> None:
        self.changed.append(spec)

    def explain(self, question: Mapping[str, Any]) -> Mapping[str, Any]:
        self.asked.append(question["spec"]["parameters"])
        if self.answer is None:
            raise UnavailableError("manager: nobody answers")
        return self.answer


def change(platform: Running) -> str:
    spec = {**PRESENT, "parameters": {"limit": 99}}
    document = {"metadata": {"namespace": "cloud-0", "name": "convoy"}, "spec": spec}
    return submit._write(cast("Platform", platform), document, False)


def test_parameters_that_the_manager_refuses_change_nothing() -> None:
    platform = Running(REFUSED)
    with pytest.raises(RefusalError, match="Nothing was changed, and what runs for the task goes on") as refusal:
        change(platform)
    assert str(refusal.value).startswith(f"InvalidParameters: {LIMIT}. ")
    assert (platform.asked, platform.changed) == ([{"limit": 99}], [])


@pytest.mark.parametrize("answer", [{"outcome": "Met"}, {**REFUSED, "reason": "NoCapableNode"}, None])
def test_what_may_run_later_is_written(answer: Mapping[str, Any] | None, capsys: pytest.CaptureFixture[str]) -> None:
    platform = Running(answer)
    assert change(platform) == "changed"
    said = "" if answer else "changed without asking the manager first: manager: nobody answers\n"
    assert capsys.readouterr().err == said
    assert platform.changed == [{**PRESENT, "parameters": {"limit": 99}}]
