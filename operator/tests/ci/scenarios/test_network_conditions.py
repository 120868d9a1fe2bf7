"""A run gives cables their conditions, opens holes, says what was measured, and takes all of it away."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from ci.cluster_contract.network_conditions import Measured, NetworkConditions, Traffic
from ci.errors import SetUpError
from scenarios import definition
from scenarios.runner.inputs import AuditGap, HoleDone, NetworkOfRun, RunInputs
from scenarios.runner.judging import naming, network
from scenarios.runner.observing import storage
from scenarios.runner.playing import cables
from scenarios.runner.reporting import page
from tests.stages.paths import SCENARIOS
from tests.stages.waiting import until

FOLDER = SCENARIOS / "pose-point-cloud-db-recording"
SECOND = 1_000_000_000
CLOUD = "/vehicles/vehicle_00/lidar_center/pointcloud"
MEASURED = Measured((36.0, 51.0, 66.0), 49.0, None, 6000, 1)
TRAFFIC = {"up": Traffic(20_000, 2, 0, 0), "down": Traffic(9_000, 1, 0, 0)}
ASKED = {"up_mbit": 50.0, "round_trip_ms": 50.0, "jitter_ms": 15.0, "loss_percent": 0.01}


class Emulator:
    """A provider that notes what is asked of it."""

    def __init__(self, refusal: str = "") -> None:
        self.done: list[Any] = []
        self.refusal = refusal

    def check(self, wanted: Mapping[str, NetworkConditions]) -> None:
        if self.refusal:
            raise SetUpError(self.refusal)

    def apply(self, wanted: Mapping[str, NetworkConditions]) -> Mapping[str, tuple[str, ...]]:
        self.done.append(dict(wanted))
        return dict.fromkeys(wanted, ("loss: somewhere",))

    def probe(self) -> Mapping[str, Measured]:
        return dict.fromkeys(self.done[-1], MEASURED)

    def cut(self, agent: str, seconds: float) -> None:
        if self.refusal:
            raise SetUpError(self.refusal)
        self.done.append((agent, seconds))

    def traffic(self, agent: str) -> Mapping[str, Traffic]:
        return TRAFFIC

    def relay_dropped(self) -> int:
        return 0

    def clear(self) -> None:
        self.done.append("clear")


def of_variant(variant: str | None, emulator: Emulator) -> tuple[cables.Cables, list[str]]:
    said: list[str] = []
    return cables.Cables(definition.load(FOLDER, variant=variant), emulator, said.append), said


def test_a_run_without_a_network_touches_no_cable() -> None:
    emulator = Emulator()
    run, said = of_variant(None, emulator)
    run.begin()
    run.play(time.time_ns())
    assert (emulator.done, said) == ([], [])
    assert run.finish() == ()


def test_what_was_asked_measured_and_where_it_acts_is_said() -> None:
    emulator = Emulator()
    run, said = of_variant("mobile-network", emulator)
    run.begin()
    assert [*emulator.done[0]] == ["vehicle-00", "vehicle-01", "vehicle-02"]
    assert said[1] == (
        "network of vehicle-00: asked up_mbit 50, round_trip_ms 50, jitter_ms 15, loss_percent 0.01; measured round "
        "trip 51.0 ms (36.0 to 66.0), 49.0 Mbit/s up, 1 of 6000 packets lost"
    )
    assert said[2] == "  loss: somewhere"
    [first, *_] = run.finish()
    assert emulator.done[-1] == "clear"
    assert "  up: 20000 packets, 2 lost, 0 in holes, queue full for 0" in cables.lines([first])


def test_a_hole_is_opened_when_it_is_due_and_the_moment_is_noted() -> None:
    emulator = Emulator()
    run, _ = of_variant("hole-in-coverage", emulator)
    run.begin()
    run.play(time.time_ns() - 18 * SECOND)
    until(lambda: ("vehicle-00", 5) in emulator.done, "opened")
    [cable] = run.finish()
    [hole] = cable.holes
    assert (hole.at_seconds, hole.seconds) == (18, 5)
    assert hole.began_seconds == pytest.approx(18, abs=5)


def test_a_run_that_ends_before_its_hole_opens_none() -> None:
    emulator = Emulator()
    run, _ = of_variant("hole-in-coverage", emulator)
    run.begin()
    run.play(time.time_ns() + 100 * SECOND)
    [cable] = run.finish()
    assert cable.holes == (HoleDone(18, 5, None),)
    assert "network of vehicle-00: its hole at 18 s was not opened" in network.problems([cable])


def test_what_keeps_a_hole_from_opening_is_a_warning() -> None:
    emulator = Emulator()
    run, _ = of_variant("hole-in-coverage", emulator)
    run.begin()
    emulator.refusal = "no nft"
    run.play(time.time_ns() - 18 * SECOND)
    until(lambda: run.warnings, "noted")
    run.finish()
    assert run.warnings == ["the hole of vehicle-00 at 18 s was not opened: no nft"]


def test_what_the_provider_cannot_do_is_said_before_anything_starts() -> None:
    run, _ = of_variant("mobile-network", Emulator("this kernel has no tbf"))
    with pytest.raises(SetUpError, match="no tbf"):
        run.check()


def cable(**changes: Any) -> NetworkOfRun:
    whole = NetworkOfRun("vehicle-00", ASKED, ("rate up: tbf",), MEASURED, TRAFFIC, (), 0)
    return replace(whole, **changes)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"measured": replace(MEASURED, up_mbit=30.0)}, "up_mbit 50 was asked for, 30.0 was measured"),
        ({"measured": replace(MEASURED, up_mbit=None)}, "up_mbit 50 was asked for, nothing was measured"),
        ({"measured": replace(MEASURED, up_mbit=60.0)}, "up_mbit 50 was asked for, 60.0 was measured"),
        ({"measured": replace(MEASURED, round_trip_ms=(0.1, 0.2, 0.3))}, "50 was asked for, 0.2 in the median was"),
        ({"measured": replace(MEASURED, round_trip_ms=(50.0, 90.0, 99.0))}, "50 was asked for, 90.0 in the median was"),
        ({"measured": None}, "round_trip_ms 50 was asked for, nothing was measured"),
        ({"traffic": {"up": Traffic(20_000, 40, 0, 0)}}, "up 40 of 20000 packets were lost, 2 were to be expected"),
        ({"asked": {"loss_percent": 5.0}}, "up 2 of 20000 packets were lost, 1000 were to be expected"),
        ({"holes": (HoleDone(5, 5, None),)}, "its hole at 5 s was not opened"),
        ({"holes": (HoleDone(5, 5, 7.5),)}, "its hole at 5 s began at 7.500 s"),
        ({"holes": (HoleDone(5, 5, 5.1),)}, "its holes dropped no packet"),
        ({"relay_dropped": 3}, "lost 3 packets, which nobody had asked for"),
    ],
)
def test_a_link_that_was_not_as_asked_is_named(changes: Mapping[str, Any], words: str) -> None:
    assert any(words in problem for problem in network.problems([cable(**changes)]))


def test_a_link_as_asked_has_no_problem() -> None:
    opened = {"up": Traffic(20_000, 2, 700, 0), "down": Traffic(9_000, 1, 20, 0)}
    assert network.problems([cable(), cable(holes=(HoleDone(5, 5, 5.1),), traffic=opened)]) == []


def test_a_run_whose_network_is_not_as_asked_fails_and_says_why(run: Any) -> None:
    run.scenario = replace(
        run.scenario, expectations={**run.scenario.expectations, "network_as_asked": definition.Bound("equals", True)}
    )
    assert run.failed() == {"network_as_asked"}
    run.change(cables=(cable(),))
    assert run.failed() == set()
    run.change(cables=(cable(measured=None),))
    assert run.failed() == {"network_as_asked"}
    assert "round_trip_ms 50 was asked for, nothing was measured" in " ".join(run.judge().document["warnings"])


def gap(first: int, last: int, count: int | None, topic: str = CLOUD, why: str = "too many waited") -> AuditGap:
    return AuditGap("recording-0", topic, "mqtt-bridge of vehicle-00", why, count, first, last)


def without_clouds(run: Any, numbers: range) -> list[int]:
    """Take clouds out of the first recording; their stamps."""
    entries = [one for one in run.index if one["recording"] == "recording-0" and one["topic"] == CLOUD]
    chosen = entries[numbers.start : numbers.stop]
    run.index = [one for one in run.index if one not in chosen]
    return [one["stamp"] for one in chosen]


def named(run: Any) -> tuple[int | None, int | None]:
    run.scenario = replace(
        run.scenario,
        expectations={
            **run.scenario.expectations,
            "missing_unnamed": definition.Bound("equals", 0),
            "named_but_present": definition.Bound("equals", 0),
        },
    )
    measured = {row.name: row.measured for row in run.judge().table}
    return measured["missing_unnamed"], measured["named_but_present"]


def test_an_audit_that_names_exactly_what_is_missing(run: Any) -> None:
    stamps = without_clouds(run, range(40, 60))
    assert named(run) == (20, 0)
    run.change(gaps=(gap(stamps[0], stamps[9], 10), gap(stamps[10], stamps[-1], 10)))
    assert named(run) == (0, 0)
    run.change(gaps=(gap(stamps[0], stamps[9], None), gap(stamps[10], stamps[-1], 10)))
    assert named(run) == (0, 0)


def test_an_audit_that_names_too_little_or_too_much(run: Any) -> None:
    stamps = without_clouds(run, range(40, 60))
    run.change(gaps=(gap(stamps[0], stamps[4], 5),))
    assert named(run) == (15, 0)
    run.change(gaps=(gap(stamps[0] - 3 * SECOND // 10, stamps[-1], 20),))
    assert named(run) == (0, 3)
    run.change(gaps=(gap(stamps[0], stamps[-1], 20, topic="/another"),))
    assert named(run) == (20, 0)


def test_what_no_gap_can_say_is_not_asked(run: Any) -> None:
    """Behind the last cloud that is stored nothing follows by which a bridge could report it."""
    entries = [one for one in run.index if one["recording"] == "recording-0" and one["topic"] == CLOUD]
    run.index = [one for one in run.index if one not in entries[-25:]]
    assert named(run) == (0, 0)
    assert run.failed() >= {"lost"}


def test_poses_that_are_lost_are_counted_apart(run: Any) -> None:
    bounds = {"poses_lost": definition.Bound("equals", 0), "lost": definition.Bound("at_least", 1)}
    run.scenario = replace(run.scenario, expectations={**run.scenario.expectations, **bounds})
    without_clouds(run, range(40, 45))
    assert run.failed() == set()
    pose = definition.pose_topic("vehicle-00")
    of_pose = [sample for sample in run.samples if sample["recording"] == "recording-0" and sample["topic"] == pose]
    run.samples = [sample for sample in run.samples if sample not in of_pose[100:103]]
    rows = {row.name: row.measured for row in run.judge().table}
    assert (rows["poses_lost"], rows["lost"]) == (3, 8)


def test_without_what_was_stored_nothing_is_known_of_it() -> None:
    assert naming.unnamed([]) is None
    assert network.as_asked(with_cables(())) is None


def with_cables(given: tuple[NetworkOfRun, ...]) -> RunInputs:
    nothing: dict[str, Any] = dict.fromkeys(
        ("stored", "recordings", "edges", "plans", "pull_requests", "commits", "pods"), ()
    )
    return RunInputs(
        run="run", provider="memory", started=0, ended=1, ledgers={}, input_before=None, input_after=None, broker=None,
        releases_before={}, releases_after={}, cables=given, **nothing,
    )  # fmt: skip


def test_gaps_that_two_writers_were_told_count_once() -> None:
    one = {"where": "mqtt-bridge of v", "why": "late", "count": 2, "first": 1, "last": 5}
    documents = [{"recording": "r", "topic": "/t", "gaps": [one]}, {"recording": "r", "topic": "/t", "gaps": [one]}]
    assert storage.gaps(documents) == (AuditGap("r", "/t", "mqtt-bridge of v", "late", 2, 1, 5),)


def test_the_report_shows_links_and_what_is_named_as_missing(run: Any) -> None:
    before = run.judge().document
    assert not {"network", "missing"} & set(before)
    stamps = without_clouds(run, range(40, 60))
    run.change(cables=(cable(holes=(HoleDone(18, 5, 18.004),)),), gaps=(gap(stamps[0], stamps[-1], 20),))
    done = run.judge()
    document = json.loads(json.dumps(done.document))
    [row] = document["network"]
    assert row["asked"] == ASKED
    assert row["measured"]["round_trip_ms"] == {"least": 36.0, "median": 51.0, "greatest": 66.0}
    assert row["packets"]["up"] == {"packets": 20000, "lost": 2, "in_holes": 0, "queue_full": 0}
    first = {one["topic"]: one for one in document["missing"][0]}
    assert (first[CLOUD]["missing"], first[CLOUD]["unnamed"], first[CLOUD]["gaps"][0]["count"]) == (20, 0, 20)
    shown = page.page_of(document)
    for words in ("round trip 51 ms (36 to 66)", "hole at 18 s for 5 s", "hole began at 18.004 s", "rate up: tbf"):
        assert words in shown
    assert "mqtt-bridge of vehicle-00: too many waited: 20 in 1 gaps" in shown
