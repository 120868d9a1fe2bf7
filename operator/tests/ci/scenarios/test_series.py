"""What the drawings are made of is measured from the inputs of a report, bounded in size, and loses none."""

from __future__ import annotations

import json
from dataclasses import replace
from math import nan
from typing import Any

import pytest

from scenarios.definition import cloud_topic, pose_topic
from scenarios.runner.inputs import CoresUsed, RunInputs, TopicCount
from scenarios.runner.judging.encounters import encounters
from scenarios.runner.reporting import page, report, series
from scenarios.runner.reporting.series import thinning
from tests.stages.scenarios.healthy_run import SECOND, START, Run

ONE = "vehicle-00"


def drawings(run: Run) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(report.text(run.judge().document))
    drawn: dict[str, Any] = document["drawings"]
    return drawn


def test_a_healthy_run_has_every_drawing(run: Run) -> None:
    made = page.page(run.judge())
    assert "not drawn" not in made
    assert made.count("<svg ") == 2 + 1 + 4 + 1 + 2 + 1
    assert "<script" not in made
    assert len(report.text(run.judge().document)) < 150_000


def test_routes_are_thinned_and_stored_poses_lie_on_them(run: Run) -> None:
    given = drawings(run)["trajectories"]
    one, seconds = given["agents"][ONE], given["seconds"]
    assert list(given["agents"]) == list(run.scenario.lidar_vehicles)
    assert seconds[:3] == [0.0, 0.2, 0.4]
    assert len(seconds) == len(one["x_m"]) == len(one["y_m"]) == 5 * int(seconds[-1]) + 1
    stored = one["stored"]
    assert 150 < len(stored["seconds"]) < 250
    places = dict(zip(seconds, zip(one["x_m"], one["y_m"], strict=True), strict=True))
    for moment, x, y in zip(stored["seconds"], stored["x_m"], stored["y_m"], strict=True):
        assert (x, y) == pytest.approx(places[round(moment * 5) / 5], abs=20 * 0.1 + 0.01)  # at 20 m/s


def test_a_stored_pose_that_cannot_be_read_has_no_place(run: Run) -> None:
    for bucket in run.samples:
        bucket["samples"][0]["data"] = bucket["samples"][0]["data"][:12]
    assert drawings(run)["trajectories"]["agents"][ONE]["stored"] == {"seconds": [], "x_m": [], "y_m": []}


def test_a_run_that_broke_off_has_routes_as_far_as_it_came(run: Run) -> None:
    run.change(ended=START + 10 * SECOND)
    assert drawings(run)["trajectories"]["seconds"][-1] == 10.0


def test_without_an_encounter_the_lidars_have_routes(run: Run) -> None:
    run.change(edges=())
    given = drawings(run)
    assert given["encounters"] == given["recordings"] == []
    assert list(given["trajectories"]["agents"]) == list(run.scenario.lidar_agents)
    made = page.page(run.judge())
    assert "ways not drawn: there are no encounters" in made
    assert "Trajectories from above: no encounter" in made


def test_ages_are_those_between_the_two_readings_and_of_the_run_s_seconds(run: Run) -> None:
    assert run.known.input_before
    before = run.known.input_before.topics[pose_topic(ONE)]
    earlier = replace(before, ages_ms={12: 7}, age_quantiles_ms={})
    run.change(input_before=replace(run.known.input_before, topics={pose_topic(ONE): earlier}))
    given = drawings(run)["pose_ages"]
    seconds = (run.known.ended - START) // SECOND
    assert given["milliseconds"] == [12, 40]
    assert given["poses"] == [3 * 99 * seconds - 7, 3 * seconds]
    assert given["vehicles"][ONE] == {
        "seconds": list(range(seconds)),
        "p50_ms": [12] * seconds,
        "p99_ms": [40] * seconds,
    }


def test_ages_of_a_long_run_are_thinned_without_hiding_the_oldest(run: Run) -> None:
    assert run.known.input_after
    first = START // SECOND
    count = TopicCount(1, 0, {}, {1: 1}, {first + n: (n % 3, 900 if n == 700 else 20) for n in range(1000)})
    run.change(ended=START + 2000 * SECOND, input_after=replace(run.known.input_after, topics={pose_topic(ONE): count}))
    assert drawings(run)["pose_ages"] is None  # the other vehicles were not heard
    run.change(
        input_after=replace(run.known.input_after, topics={pose_topic(agent): count for agent in run.scenario.vehicles})
    )
    one = drawings(run)["pose_ages"]["vehicles"][ONE]
    assert len(one["seconds"]) <= thinning.POINTS_MAX
    assert one["seconds"][:2] == [0, 4]
    assert one["p99_ms"].count(900) == 1


def test_the_steps_of_an_encounter_follow_each_other(run: Run) -> None:
    first = drawings(run)["encounters"][0]
    assert first["agents"] == ["vehicle-00", "vehicle-01"]
    assert first["start"] == {"seconds": 5.0, "distance_m": 399.9}
    for phase, begin, end in (("deployment", "event", "first point cloud stored"), ("removal", "", "last pod gone")):
        path = [step for step in first[phase] if step["critical"]]
        assert [step["begin"] for step in path[1:]] == [step["end"] for step in path[:-1]]
        moments = {one["what"]: one["seconds"] for one in first["moments"]}
        assert path[-1]["end"] == moments[end]
        assert not begin or path[0]["end"] == moments[begin]
    assert [step["step"] for step in first["deployment"] if not step["critical"]] == ["pod ready", "plan observed"]


def test_steps_that_were_not_seen_are_left_out(run: Run) -> None:
    run.change(plans=(), pods=())
    first = drawings(run)["encounters"][0]
    assert [step["step"] for step in first["deployment"]] == ["pose on its way", "detection", "storing"]
    assert page.page(run.judge())


def test_cores_are_those_of_the_greatest_components_and_of_all_others(run: Run) -> None:
    given = drawings(run)["cores"]
    assert list(given["components"]) == [*(f"component-{n}" for n in range(7)), "all others"]
    assert given["seconds"][:2] == [-2.0, -1.0]
    sums = [sum(values) for values in zip(*given["components"].values(), strict=True)]
    assert sums == pytest.approx([sum(0.5 / (n + 1) for n in range(10))] * (len(given["seconds"]) - 1), abs=1e-3)


def test_cores_of_a_long_run_are_averages(run: Run) -> None:
    times = tuple(START + n * SECOND for n in range(602))
    run.change(cores=CoresUsed(times, {"etcd": tuple(float(n % 3) for n in range(601))}))
    given = drawings(run)["cores"]
    assert given["seconds"][:2] == [0.0, 3.0]
    assert given["seconds"][-1] == 601.0
    assert set(given["components"]["etcd"][:-1]) == {1.0}


def test_a_recording_names_what_is_missing(run: Run) -> None:
    topic = cloud_topic(ONE)
    lost = [entry for entry in run.index if entry["topic"] == topic and entry["recording"] == "recording-0"][20:23]
    run.index = [entry for entry in run.index if entry not in lost]
    first, second = drawings(run)["recordings"]
    assert first["lost"] == 3
    by_topic = {(one["agent"], one["what"]): one for one in first["topics"]}
    clouds = by_topic[ONE, "point clouds"]
    begin, end = ((stamp - START) / SECOND for stamp in (lost[0]["stamp"], lost[-1]["stamp"]))
    assert clouds["gaps"] == [[pytest.approx(begin - 0.1), pytest.approx(end + 0.1)]]
    assert first["window"][1] == 27.5
    assert all(one["gaps_total"] == 0 for one in second["topics"])
    assert len(by_topic) == 4


def test_what_does_not_reach_the_end_of_the_window_is_a_gap(run: Run) -> None:
    stop = START + int(27.5 * SECOND)
    run.samples = [
        sample for sample in run.samples if not stop - 2 * SECOND < sample["samples"][0]["stamp"] <= stop + SECOND
    ]
    poses = drawings(run)["recordings"][0]["topics"][0]
    assert poses["gaps"][-1] == [25.5, 27.5]


def test_a_series_that_cannot_be_made_is_a_warning_and_the_report_is_there(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("odd inputs")

    monkeypatch.setitem(series.SOURCES, "cores", broken)
    done = run.judge()
    assert done.passed
    assert done.document["drawings"]["cores"] is None
    assert done.document["warnings"] == ["series cores of the drawings: ZeroDivisionError: odd inputs"]
    assert "cores not drawn" in page.page(done)


def nothing(known: RunInputs) -> dict[str, Any]:
    return {"input_before": None, "input_after": None, "cores": None, "edges": (), "plans": (), "pods": ()}


def no_numbers(known: RunInputs) -> dict[str, Any]:
    return {
        "edges": tuple(replace(edge, distance_m=nan) for edge in known.edges),
        "cores": CoresUsed((START, START), {"etcd": (nan,)}),
    }


@pytest.mark.parametrize("change", [nothing, no_numbers])
def test_a_report_of_odd_inputs_can_be_written_and_shown(run: Run, change: Any) -> None:
    run.change(**change(run.known))
    done = run.judge()
    assert json.loads(report.text(done.document))["scenario"] == run.scenario.name
    assert "<h2>Audit</h2>" in page.page(done)


def test_a_vehicle_that_met_itself_or_nobody_loses_nothing(run: Run) -> None:
    met = encounters(run.scenario, run.inputs())
    alone = [replace(one, start=replace(one.start, agents=(ONE,))) for one in met]
    made, warnings = series.series(run.scenario, run.inputs(), alone)
    assert list(made["trajectories"]["agents"]) == [ONE]
    assert warnings == ()


def test_lists_of_numbers_take_one_line_and_texts_stay_as_they_are() -> None:
    document = {"a": [1, 2.5, None], "b": "[\n 1, 2 ]", "c": [[1, 2], ["x"]]}
    text = report.text(document)
    assert json.loads(text) == document
    assert '"a": [1, 2.5, null],' in text
    assert "[1, 2]" in text
