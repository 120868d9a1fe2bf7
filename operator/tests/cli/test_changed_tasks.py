"""A mistyped parameter takes away no task that runs, and makes none: `task submit` asks the manager before writing."""

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
    """A platform with one task, or none; `answer` is the manager's to /explain."""

    def __init__(self, answer: Mapping[str, Any] | None, releases: tuple[str, ...] = ("a/b",)) -> None:
        self.answer = answer
        self.asked = list[Any]()
        self.changed = list[Any]()
        self.present: Mapping[str, Any] | None = {"spec": PRESENT, "status": {"releases": releases}}
        self.created = 0

    def task_writer(self, dry_run: bool) -> Running:
        return self

    def create(self, document: Mapping[str, Any]) -> bool:
        self.created += 1
        return True

    def find(self, namespace: str, name: str) -> Mapping[str, Any] | None:
        return self.present

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
    with pytest.raises(RefusalError, match=r"Nothing was changed$"):
        change(Running(REFUSED, releases=()))


def test_nothing_is_submitted_that_would_be_refused_for_its_parameters() -> None:
    platform = Running(REFUSED)
    platform.present = None
    with pytest.raises(RefusalError, match=r"Nothing was submitted$"):
        change(platform)
    assert platform.created == 0
    platform.answer = {"outcome": "Met"}
    assert (change(platform), platform.created) == ("submitted", 1)


@pytest.mark.parametrize("answer", [{"outcome": "Met"}, {**REFUSED, "reason": "NoCapableNode"}, None])
def test_what_may_run_later_is_written(answer: Mapping[str, Any] | None, capsys: pytest.CaptureFixture[str]) -> None:
    platform = Running(answer)
    assert change(platform) == "changed"
    said = "" if answer else "the manager was not asked first: manager: nobody answers\n"
    assert capsys.readouterr().err == said
    assert platform.changed == [{**PRESENT, "parameters": {"limit": 99}}]
