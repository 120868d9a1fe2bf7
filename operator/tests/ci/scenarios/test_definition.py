"""A scenario file that cannot be run is refused before anything starts, with file, key and fix."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from scenarios import definition
from scenarios.generator import coverage, routes
from tests.stages.paths import SCENARIOS

FOLDER = SCENARIOS / "pose-point-cloud-db-recording"


def test_the_papers_numbers_are_the_defaults() -> None:
    scenario = definition.load(FOLDER)
    assert scenario.parameters == definition.Parameters(15, 2, 100, 10, 20000, 400, 500, 2, 20)
    assert len(scenario.nodes) == 17
    assert [node.role for node in scenario.nodes[:3]] == ["platform", "cloud", "vehicle"]
    assert scenario.vehicles[-1] == "vehicle-14"
    assert scenario.lidar_vehicles == ("vehicle-00", "vehicle-01")


def test_the_small_variant_has_five_nodes_and_overrides_win() -> None:
    assert len(definition.load(FOLDER, variant="small").nodes) == 5
    assert definition.load(FOLDER, ["vehicles=4"], "small").parameters.vehicles == 4
    assert definition.load(FOLDER, variant="small").parameters.encounters == 1


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("vehicles", "must have the form key=value"),
        ("wheels=4", r"has no parameter 'wheels'; it has: vehicles, "),
        ("vehicles=1", r"parameters\.vehicles: 1 is less than the minimum of 2"),
        ("vehicles=three", r"parameters\.vehicles: 'three' is not of type 'integer'"),
        ("stop_distance_m=300", r"parameters\.stop_distance_m: 300 must be greater than start_distance_m \(400\)"),
        ("lidar_vehicles=3", r"parameters\.lidar_vehicles: 2 was expected"),
    ],
)
def test_bad_overrides_are_refused(override: str, message: str) -> None:
    with pytest.raises(definition.ScenarioError, match=message):
        definition.load(FOLDER, [override])


def test_an_unknown_variant_is_refused() -> None:
    with pytest.raises(
        definition.ScenarioError,
        match=r"variants: there is no variant 'tiny'; there is: hole-in-coverage, manager-killed, ",
    ):
        definition.load(FOLDER, variant="tiny")


def test_too_fast_for_a_recording_is_refused() -> None:
    parameters = definition.load(FOLDER, ["speed_mps=40"]).parameters
    with pytest.raises(definition.ScenarioError, match=r"speed_mps: 40: an encounter would last 11\.2 s"):
        routes.duration_seconds(parameters)


def changed(tmp_path: Path, **changes: Any) -> Path:
    document = yaml.safe_load((FOLDER / "scenario.yaml").read_text())
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(document | changes))
    return tmp_path


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"colour": "red"}, r"scenario\.yaml: \(top\): .*'colour' was unexpected.*allowed: the keys apiVersion, "),
        ({"expectations": {}}, r"expectations: 'pose_hz_min' is a required property"),
        (
            {
                "topology": {
                    "nodes": [
                        {
                            "name": "a",
                            "role": "boat",
                            "agent": "a",
                            "capacity": {"cpu": "1", "memory": "1Gi"},
                            "capabilities": [],
                        }
                    ]
                }
            },
            r"topology\.nodes\.0\.role: 'boat' is not one of",
        ),
        (
            {
                "topology": {
                    "nodes": [
                        {
                            "name": "v",
                            "count": 15,
                            "role": "vehicle",
                            "agent": "v",
                            "capacity": {"cpu": "1", "memory": "1Gi"},
                            "capabilities": [],
                        }
                    ]
                }
            },
            r"v occurs twice; put \{index:02\}",
        ),
        (
            {
                "topology": {
                    "nodes": [
                        {
                            "name": "v",
                            "role": "vehicle",
                            "agent": "v",
                            "capacity": {"cpu": "1", "memory": "1Gi"},
                            "capabilities": [],
                        }
                    ]
                }
            },
            r"1 nodes of role vehicle, but parameter vehicles is 15",
        ),
        (
            {
                "topology": {
                    "nodes": [
                        {
                            "name": "v{number}",
                            "role": "vehicle",
                            "agent": "v",
                            "capacity": {"cpu": "1", "memory": "1Gi"},
                            "capabilities": [],
                        }
                    ]
                }
            },
            r"v\{number\}: only \{index\} can stand in braces",
        ),
    ],
)
def test_bad_files_are_refused(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(definition.ScenarioError, match=message):
        definition.load(changed(tmp_path, **changes))


def test_what_is_no_yaml_and_what_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(definition.ScenarioError, match="there is no such file"):
        definition.load(tmp_path)
    (tmp_path / "scenario.yaml").write_text("a: [")
    with pytest.raises(definition.ScenarioError, match="not valid YAML"):
        definition.load(tmp_path)
    (tmp_path / "scenario.yaml").write_text("- a")
    with pytest.raises(definition.ScenarioError, match="must be a mapping"):
        definition.load(tmp_path)


@pytest.mark.parametrize(
    ("bound", "inside", "outside"),
    [(("at_least", 95), 95, 94.9), (("at_most", 8), 8, 8.1), (("equals", True), True, False), (("equals", 0), 0, 1)],
)
def test_bounds(bound: tuple[str, float], inside: float, outside: float) -> None:
    limit = definition.Bound(*bound)
    assert limit.holds(inside)
    assert not limit.holds(outside)
    assert not limit.holds(None)


ROLE = {"role": "vehicle", "up_mbit": 20}


@pytest.mark.parametrize(
    ("network", "message"),
    [
        (
            [{"role": "vehicle", "upMbit": 20}],
            r"network\.0: .*'upMbit' was unexpected.*the keys agent, down_mbit, holes",
        ),
        ([{"role": "vehicle", "up_mbit": 0}], r"network\.0\.up_mbit: 0 is less than the minimum of 0\.1"),
        ([{"up_mbit": 20}], r"network\.0: must name either a role or an agent"),
        (
            [{"role": "vehicle", "agent": "vehicle-00", "up_mbit": 20}],
            r"network\.0: must name either a role or an agent",
        ),
        ([{"role": "platform", "up_mbit": 20}], r"network\.0\.role: 'platform' is not one of"),
        (
            [{"role": "edge", "up_mbit": 20}],
            r"network\.0\.role: 'edge' is no role of the topology.*there is: cloud, veh",
        ),
        (
            [{"agent": "vehicle-99", "up_mbit": 20}],
            r"network\.0\.agent: 'vehicle-99' is no agent.*there is: cloud-0, v",
        ),
        ([{"agent": "platform-0", "up_mbit": 20}], r"network\.0\.agent: 'platform-0' is no agent"),
        ([ROLE, ROLE], r"network\.1\.role: vehicle has an entry already; make one of both"),
        (
            [{"role": "vehicle"}],
            r"network\.0: says nothing about the cable; give one of up_mbit, down_mbit, round_trip",
        ),
        (
            [{"role": "vehicle", "round_trip_ms": 10, "jitter_ms": 15}],
            r"jitter_ms: 15 must be at most round_trip_ms \(10\)",
        ),
        ([{"role": "vehicle", "loss_percent": 60}], r"loss_percent: 60 is greater than the maximum of 50"),
        ([{**ROLE, "holes": [{"at_seconds": 5}]}], r"network\.0\.holes\.0: 'seconds' is a required property"),
        ([{**ROLE, "holes": [{"x_m": 5, "y_m": 0}]}], r"network\.0\.holes\.0: 'radius_m' is a required property"),
        ([{**ROLE, "holes": [{"at_seconds": 5, "seconds": 1, "radius_m": 5}]}], r"'radius_m' was unexpected"),
    ],
)
def test_links_that_mean_nothing_are_refused(tmp_path: Path, network: list[dict[str, Any]], message: str) -> None:
    with pytest.raises(definition.ScenarioError, match=message):
        definition.load(changed(tmp_path, network=network))


def test_an_agents_own_link_stands_in_place_of_its_roles(tmp_path: Path) -> None:
    own = {"agent": "vehicle-01", "round_trip_ms": 80}
    network = definition.load(changed(tmp_path, network=[ROLE, own]), ["vehicles=3"]).network
    assert {agent: cable.asked for agent, cable in network.items()} == {
        "vehicle-00": {"up_mbit": 20},
        "vehicle-01": {"round_trip_ms": 80},
        "vehicle-02": {"up_mbit": 20},
    }


def test_a_variant_has_a_network_of_its_own(tmp_path: Path) -> None:
    assert definition.load(FOLDER).network == {}
    assert [*definition.load(FOLDER, variant="mobile-network").network] == ["vehicle-00", "vehicle-01", "vehicle-02"]
    assert [*definition.load(FOLDER, variant="hole-in-coverage").network] == ["vehicle-00"]


@pytest.mark.parametrize("variant", ["mobile-network", "narrow-uplink", "hole-in-coverage"])
def test_variants_with_a_network_say_what_they_must_show(variant: str) -> None:
    scenario = definition.load(FOLDER, variant=variant)
    bounds = {name: str(scenario.expectations[name]) for name in ("network_as_asked", "poses_lost", "lost")}
    everything = variant == "mobile-network"
    assert bounds == {"network_as_asked": "= true", "poses_lost": "= 0", "lost": "= 0" if everything else ">= 1"}
    assert everything or str(scenario.expectations["missing_unnamed"]) == "= 0"


def test_holes_by_place_follow_from_the_routes(tmp_path: Path) -> None:
    """The pair meets in the middle of the road, at 4 m from it on either side: 5 s of lead-in, 200 m at 20 m/s."""
    place = {"x_m": 0, "y_m": 0, "radius_m": 50}
    network = [
        {"role": "vehicle", "holes": [place]},
        {"agent": "vehicle-01", "holes": [{"at_seconds": 1, "seconds": 2}]},
    ]
    scenario = definition.load(changed(tmp_path, network=network), ["vehicles=3", "encounters=1"])
    first, second = coverage.coverage_holes(scenario)
    assert (first.agent, first.at_seconds, first.seconds) == ("vehicle-01", 1, 2)
    assert second.agent == "vehicle-00"
    assert second.at_seconds == pytest.approx(15 - 2.5, abs=0.1)
    assert second.seconds == pytest.approx(5, abs=0.1)


def test_holes_that_overlap_are_one(tmp_path: Path) -> None:
    holes = [{"at_seconds": 4, "seconds": 3}, {"at_seconds": 1, "seconds": 4}, {"at_seconds": 9, "seconds": 1}]
    scenario = definition.load(changed(tmp_path, network=[{"agent": "vehicle-00", "holes": holes}]))
    assert [(hole.at_seconds, hole.seconds) for hole in coverage.coverage_holes(scenario)] == [(1, 6), (9, 1)]


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (
            {"role": "vehicle", "holes": [{"at_seconds": 500, "seconds": 5}]},
            r"the hole of vehicle-00 at 500 s .* ends after",
        ),
        (
            {"role": "vehicle", "holes": [{"x_m": 9000, "y_m": 0, "radius_m": 5}]},
            r"nobody who has a hole there comes within",
        ),
        ({"role": "cloud", "holes": [{"x_m": 0, "y_m": 0, "radius_m": 5}]}, r"cloud-0 does not drive"),
    ],
)
def test_holes_that_no_run_would_show_are_refused(tmp_path: Path, entry: dict[str, Any], message: str) -> None:
    scenario = definition.load(changed(tmp_path, network=[entry]))
    with pytest.raises(definition.ScenarioError, match=message):
        coverage.coverage_holes(scenario)
