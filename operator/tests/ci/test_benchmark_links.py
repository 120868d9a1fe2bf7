"""What `make bench` says of links and their rights; times themselves are judged by nobody here."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.broker import links, rights
from benchmarks.broker.links import LinkAges
from benchmarks.measuring.comparisons import Quantiles


def of(p99: float) -> Quantiles:
    return Quantiles(100, p99 / 2, p99, p99)


@pytest.fixture
def record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "links.json"
    for module in (links, rights):
        monkeypatch.setattr(module, "RECORD", path)
    return path


@pytest.mark.parametrize(
    ("ages", "passed"),
    [
        (LinkAges(of(85.0), of(160.0), of(5.0)), [True, True]),
        (LinkAges(of(130.0), of(229.0), of(5.0)), [False, True]),
        (LinkAges(of(1581.0), of(2636.0), of(1715.0)), [True, True]),
    ],
)
def test_a_link_has_its_bridges_periods_and_the_machines_minutes(
    record: Path, monkeypatch: pytest.MonkeyPatch, ages: LinkAges, passed: list[bool]
) -> None:
    monkeypatch.setattr(links, "ages", lambda: ages)
    assert [one.passed for one in links.compare()] == passed
    written = json.loads(record.read_text())["link_end_to_end_ms"]
    assert set(written) == {"vehicle_vehicle", "vehicle_roadside_vehicle", "plain"}
    assert written["plain"]["p99"] == ages.plain.p99


@pytest.mark.parametrize(
    ("applied", "announced", "own", "passed"),
    [
        (577.0, 380.0, 220.0, [True, True, True]),
        (1001.0, 380.0, 621.0, [False, False, True]),
        (2866.0, 2366.0, 500.0, [True, True, True]),
        (2867.0, 2366.0, 1001.0, [False, False, False]),
    ],
)
def test_rights_have_a_second_or_what_the_forge_leaves(
    record: Path, monkeypatch: pytest.MonkeyPatch, applied: float, announced: float, own: float, passed: list[bool]
) -> None:
    seconds = {"applied": [applied], "ended": [applied], "announced": [announced], "own": [own]}
    monkeypatch.setattr(rights, "measure", lambda: seconds)
    assert [one.passed for one in rights.compare()] == passed
    written = json.loads(record.read_text())
    assert {name: values["p95"] for name, values in written.items()} == {
        "rights_applied_ms": applied,
        "rights_ended_ms": applied,
        "rights_announced_ms": announced,
        "rights_own_ms": own,
    }
