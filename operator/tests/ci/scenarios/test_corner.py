"""The corner of the intersection: a container blocks rays, so a detection is uncertain of what stands behind it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
import yaml

from robotkube.robots.perception.core.detection import REFLECTANCE, DetectedObject, ObjectCriteria, find_objects
from robotkube.robots.perception.core.detection import uncertainty as uncertainty_of
from robotkube.robots.perception.core.point_clouds import read_cloud
from scenarios import definition
from scenarios.generator import intersection, messages, routes, scene
from scenarios.generator.intersection import CONTAINER, HIDDEN, STOPPED
from tests.stages.paths import REGISTRY, SCENARIOS
from tests.stages.scenarios.corner import ABOVE, BELOW, BLOCKED, CLEAR, SITE, SITES, View, cloud, hidden_among

CRITERIA = ObjectCriteria(REFLECTANCE, range_m=60)


def points(view: View) -> np.ndarray:
    data = messages.store.deserialize_cdr(cloud(view), messages.CLOUD_TYPE).data
    return np.asarray(data.view(np.float32).reshape(-1, 4))


def objects(view: View) -> tuple[DetectedObject, ...]:
    return find_objects(read_cloud(cloud(view)), CRITERIA)


def on_vehicle(view: View) -> set[tuple[float, ...]]:
    return {tuple(point) for point in points(view) if point[3] == np.float32(scene.VEHICLE)}


def test_a_container_takes_rays_away_and_adds_none() -> None:
    """Of the vehicle behind it those points are left that were there before: rays end at what they hit first."""
    clear, blocked = on_vehicle(CLEAR), on_vehicle(BLOCKED)
    assert len(points(CLEAR)) == len(points(BLOCKED))
    assert blocked < clear
    assert 4 < len(blocked) < len(clear) / 4


def test_whoever_sees_less_is_uncertain() -> None:
    """By the detection's own rule, and the bounds of the operator's."""
    assert 0 < uncertainty_of(objects(CLEAR)) < BELOW
    assert uncertainty_of(objects(BLOCKED)) > ABOVE
    assert [len(objects(view)) for view in (CLEAR, BLOCKED)] == [1, 1]


def test_the_road_side_unit_sees_what_is_hidden() -> None:
    places = [(one.pose.x, one.pose.y) for one in objects(SITES)]
    assert len(places) == 2
    assert hidden_among(SITE, places)
    assert max(one.points for one in objects(SITES)) > 100


def test_the_bounds_are_those_of_the_operator() -> None:
    document = yaml.safe_load((REGISTRY / "applications" / "uncertainty-operator.yaml").read_text())
    known = document["spec"]["parameters"]["properties"]
    assert (known["above"]["default"], known["below"]["default"]) == (ABOVE, BELOW)


def uncertainties(places: Iterable[float], obstacles: tuple[scene.Obstacle, ...]) -> list[float]:
    """The uncertainty of the first vehicle's detection at places of its lane."""
    rays = scene.ray_directions(20_000)
    writer = messages.CloudWriter("v", len(rays))
    noise = np.zeros(len(rays), np.float32)
    values = []
    for x in places:
        seen = scene.cast(rays, scene.MOUNTS[0], scene.Place(x, STOPPED.y, 0.0), [HIDDEN], noise, obstacles)
        values.append(uncertainty_of(find_objects(read_cloud(writer.message(0, seen)), CRITERIA)))
    return values


def test_it_is_uncertain_because_of_the_container_alone_and_once() -> None:
    """Over the whole way, as far as the lidar sees that vehicle."""
    places = [float(x) for x in range(-76, 52, 3)]
    blocked = uncertainties(places, (CONTAINER,))
    assert max(uncertainties(places, ())) < ABOVE
    assert [x for x, one in zip(places, blocked, strict=True) if one > ABOVE] == [-40.0, -37.0, -34.0]


@pytest.fixture(scope="module")
def story() -> definition.Parameters:
    blocked = ("vehicles=2", "lidar_vehicles=1", "blocked_seconds=60")
    return definition.load(SCENARIOS / "intersection-support", blocked).parameters


def test_the_vehicle_stops_at_the_corner(story: definition.Parameters) -> None:
    times = np.arange(0, routes.duration_seconds(story), 0.01)
    drive = routes.motion(story, 0, times)
    steps = np.diff(drive.x) / 0.01
    assert steps.max() <= story.speed_mps + 0.01
    assert np.abs(np.diff(steps)).max() <= 0.06  # 4 m/s2
    assert np.sum(np.abs(drive.x - STOPPED.x) < 0.01) * 0.01 == pytest.approx(story.blocked_seconds, abs=0.3)
    assert routes.motion(story, 1, times).x[0] == HIDDEN.x
    assert routes.obstacles(story) == (CONTAINER,)


def test_a_story_without_a_container_is_as_before(story: definition.Parameters) -> None:
    free = replace(story, blocked_seconds=0)
    assert routes.obstacles(free) == ()
    assert intersection.near_seconds(story) - intersection.near_seconds(free) == pytest.approx(60 + 15 / 4)
    assert np.all(np.diff(routes.motion(free, 0, np.arange(0, 60, 0.1)).x) > 0)


def test_a_vehicle_that_cannot_stop_is_refused(story: definition.Parameters) -> None:
    fast = replace(story, speed_mps=50, start_distance_m=60)
    with pytest.raises(definition.ScenarioError, match="cannot stop before the corner"):
        routes.motion(fast, 0, np.arange(0, 1, 0.1))
