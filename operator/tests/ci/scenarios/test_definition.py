"""A scenario file that cannot be run is refused before anything starts, with file, key and fix."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from scenarios import definition
from scenarios.generator import routes
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
        definition.ScenarioError, match=r"variants: there is no variant 'tiny'; there is: manager-killed, small"
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
