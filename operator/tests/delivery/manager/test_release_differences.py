"""What a plan changes, value by value, and for how many plans it is remembered."""

from __future__ import annotations

from dataclasses import replace

from robotkube.delivery.deployment.core.releases import Release
from robotkube.delivery.manager.core.plans import Change
from robotkube.delivery.manager.core.release_differences import (
    TEXT_CHARACTERS_MAX,
    VALUES_MAX,
    ReleaseDifferences,
    release_differences,
)
from robotkube.delivery.manager.loops.proposals.plan_records import DIFFERENCES_MAX, PlanRecord, PlanRecords

BEFORE = Release(
    "vehicle-00",
    "mqtt-bridge",
    "mqtt-bridge",
    "0.1.2",
    "sha256:1",
    {"bridge": {"topics": [{"name": "/pose", "depth": 10}], "held": False}, "extra": {}},
)
KEY = "vehicle-00/mqtt-bridge"


def told(before: Release | None, after: Release | None) -> list[tuple[str, str | None, str | None]]:
    differences = release_differences([Change("path", before, after)])
    assert {value.release for value in differences.values} <= {KEY}
    return [(value.path, value.before, value.after) for value in differences.values]


def test_each_value_that_changes_is_told_before_and_after() -> None:
    bridge = {"topics": [{"name": "/pose", "depth": 1000}, {"name": "/list"}], "held": False}
    after = replace(BEFORE, version="0.2.3", digest="sha256:2", values={"bridge": bridge})
    assert told(BEFORE, after) == [
        ("bridge.topics[0].depth", "10", "1000"),
        ("bridge.topics[1].name", None, '"/list"'),
        ("extra", "{}", None),
        ("version", '"0.1.2"', '"0.2.3"'),
    ]


def test_a_release_that_comes_or_goes_is_told_by_its_chart() -> None:
    assert told(None, BEFORE) == [("chart", None, '"mqtt-bridge"'), ("version", None, '"0.1.2"')]
    assert told(BEFORE, None) == [("chart", '"mqtt-bridge"', None), ("version", '"0.1.2"', None)]
    assert told(BEFORE, replace(BEFORE, plan="another")) == []


def test_of_many_and_long_values_a_part_is_told_and_how_many_more_there_are() -> None:
    many = {f"v{number:03d}": "x" * 500 for number in range(VALUES_MAX + 5)}
    differences = release_differences([Change("path", BEFORE, replace(BEFORE, values={**BEFORE.values, **many}))])
    assert (len(differences.values), differences.more) == (VALUES_MAX, 5)
    assert len(differences.values[0].after or "") == TEXT_CHARACTERS_MAX + 1
    assert differences.as_json()["values"][0]["release"] == KEY


def test_the_newest_plans_have_their_differences_and_what_they_wait_for() -> None:
    records = PlanRecords(0)
    for number in range(DIFFERENCES_MAX + 3):
        choices = (("cloud-0/meeting", "recorder on cloud-0: it records"),)
        records.add(PlanRecord(str(number), "", "task", (), (), differences=ReleaseDifferences(), choices=choices))
    remembered = [record.id for record in records if record.differences is not None]
    assert remembered == [str(number) for number in range(3, DIFFERENCES_MAX + 3)]
    assert [record.id for record in records if record.choices] == remembered
    record = PlanRecord("a", "", "task", (), (), waits=("WaitsForApproval", "pull request 4: anna has not approved"))
    assert record.as_json()["waits"] == "pull request 4: anna has not approved"
    record.on_main = True
    assert (record.as_json()["waits"], record.as_json()["differences"]) == (None, None)
