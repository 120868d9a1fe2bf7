"""The drives of the scenarios besides the pair's: who is near whom, for how long, and what a road-side unit sees."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from robotkube.robots.bags.adapters.reading import open_bag
from robotkube.robots.perception.core.detection import REFLECTANCE, ObjectCriteria, find_objects
from robotkube.robots.perception.core.messages import Poses
from robotkube.robots.perception.core.point_clouds import read_cloud
from robotkube.robots.perception.core.tracking import STEADY, Tracker, TrackerSettings
from scenarios import definition
from scenarios.generator import bags, checking, drives, intersection, routes, three_vehicles
from tests.stages.paths import SCENARIOS

THREE, INTERSECTION = SCENARIOS / "three-vehicles", SCENARIOS / "intersection-support"
STEP = 0.01
FREE = ("blocked_seconds=0", "lidar_vehicles=0")


def paths(parameters: definition.Parameters, count: int) -> tuple[np.ndarray, list[drives.Motion]]:
    times = np.arange(0, routes.duration_seconds(parameters), STEP)
    return times, [routes.motion(parameters, index, times) for index in range(count)]


def encounters(parameters: definition.Parameters, first: int, second: int) -> list[tuple[float, float]]:
    """Start and stop of every event of the two, as the rule sees them."""
    times, driven = paths(parameters, max(first, second) + 1)
    events = []
    start = -1.0
    for moment, value in zip(times, routes.distance(driven[first], driven[second]), strict=True):
        if start < 0 and value < parameters.start_distance_m:
            start = float(moment)
        elif start >= 0 and value > parameters.stop_distance_m:
            events.append((start, float(moment)))
            start = -1.0
    assert start < 0, "an encounter lasts at the end"
    return events


@pytest.mark.parametrize("overrides", [(), ("start_distance_m=200", "stop_distance_m=250", "speed_mps=10")])
def test_encounters_overlap_and_the_first_pair_meets_again(overrides: tuple[str, ...]) -> None:
    parameters = definition.load(THREE, overrides).parameters
    (first, again), [second] = encounters(parameters, 0, 1), encounters(parameters, 1, 2)
    assert encounters(parameters, 0, 2) == []
    assert first[0] >= 4.9
    assert first[1] - second[0] >= 12, "the encounters overlap"
    assert second[1] - first[1] >= 12, "the second lasts alone"
    assert again[0] - second[1] >= 15, "all have parted before the first two meet again"
    assert all(stop - start >= 20 for start, stop in (first, second, again))
    assert routes.duration_seconds(parameters) - again[1] >= 17


def test_three_vehicles_drive_smoothly_and_the_fourth_is_far_away() -> None:
    parameters = definition.load(THREE).parameters
    _, driven = paths(parameters, parameters.vehicles)
    for index in (0, 2):
        steps = np.hypot(np.diff(driven[index].x), np.diff(driven[index].y)) / STEP
        assert steps.max() <= parameters.speed_mps + 0.01
        assert np.abs(np.diff(steps)).max() <= 0.06  # 4 m/s2 along the path
    nearest = min(routes.distance(driven[3], path).min() for path in driven[:3])
    assert nearest > parameters.stop_distance_m


def test_vehicles_too_fast_to_overlap_are_refused() -> None:
    with pytest.raises(definition.ScenarioError, match="24 s are needed so that two overlap"):
        three_vehicles.duration_seconds(definition.load(THREE, ["speed_mps=40"]).parameters)


def test_a_vehicle_passes_the_road_side_unit_once() -> None:
    parameters = definition.load(INTERSECTION).parameters
    [(start, stop)] = encounters(parameters, 0, parameters.vehicles)
    assert start >= 4.9
    assert stop - start >= intersection.NEAR_SECONDS_MIN
    assert routes.duration_seconds(parameters) - stop >= 17
    _, driven = paths(parameters, parameters.vehicles + 1)
    assert 10 < routes.distance(driven[0], driven[parameters.vehicles]).min() < 15
    assert np.ptp(driven[parameters.vehicles].x) == 0


def test_a_vehicle_that_rushes_by_is_refused() -> None:
    with pytest.raises(definition.ScenarioError, match="30 s are needed"):
        intersection.duration_seconds(definition.load(INTERSECTION, ["speed_mps=40", *FREE]).parameters)


@pytest.fixture(scope="module")
def passing() -> definition.Scenario:
    near = ("start_distance_m=150", "stop_distance_m=160", "speed_mps=10", "blocked_seconds=5")
    return definition.load(INTERSECTION, ("points=20000", "point_cloud_hz=4", *near))


@pytest.fixture(scope="module")
def made(passing: definition.Scenario, tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    return bags.make_bags(passing, tmp_path_factory.mktemp("cache"), lambda _: None)


def test_every_player_has_a_sound_bag(passing: definition.Scenario, made: Mapping[str, Path]) -> None:
    assert tuple(made) == passing.players == ("vehicle-00", "vehicle-01", "roadside-0")
    for agent, folder in made.items():
        checking.check_bag(folder, passing, agent)


def test_perception_on_the_road_side_unit_follows_both_vehicles(
    passing: definition.Scenario, made: Mapping[str, Path]
) -> None:
    """The bag through both services: one identity for each, the one that waits is always seen, the one that passes
    whenever it is within the range that is guaranteed."""
    bag = open_bag(made["roadside-0"])
    tracker = Tracker(TrackerSettings(STEADY, 4.0, 1.0))
    topic = definition.cloud_topic("roadside-0")
    parameters = passing.parameters
    identities = set()
    missed = []
    clouds = 0
    for name, moment, data in bag.messages():
        if name != topic:
            continue
        clouds += 1
        cloud = read_cloud(data)
        objects = find_objects(cloud, ObjectCriteria(REFLECTANCE, 60))
        identities |= {track.id for track in tracker.observe(Poses(cloud.header, tuple(one.pose for one in objects)))}
        vehicle, unit = (routes.motion(parameters, index, np.array([moment / 1e9])) for index in (0, 2))
        distance = routes.distance(vehicle, unit)[0]
        if (distance < 58 and len(objects) != 2) or (distance > 62 and len(objects) != 1):
            missed.append(moment)
    bag.close()
    assert identities == {1, 2}
    assert missed == []
    assert clouds == routes.duration_seconds(parameters) * 4
