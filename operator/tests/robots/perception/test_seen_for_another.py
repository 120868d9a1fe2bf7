"""What one agent cannot see or compute, another does for it: the stories of Table I, p08 and p10, with the processes of
every release, a broker whose rights follow main, and the manager; only the cluster is missing."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from robotkube.delivery.manager.core.placement.placement import Agent, NodeState
from scenarios.definition import cloud_topic
from scenarios.generator.messages import CLOUD_TYPE
from scenarios.generator.scene import Place
from tests.stages.delivery.manager.manager_in_memory import Stage
from tests.stages.delivery.manager.running_releases import RunningReleases
from tests.stages.platform.table_one import NUMBER, POSES, TEXT
from tests.stages.ros import lidar_clouds
from tests.stages.scenarios.corner import ABOVE, BELOW, BLOCKED, CLEAR, SITE, SITES, VEHICLE, View, cloud, hidden_among
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

UNCERTAINTY = "/vehicles/vehicle_00/uncertainty"
OBJECTS, TRACKS = "/vehicles/roadside_0/objects", "/vehicles/roadside_0/tracks"


def fleet_of(folder: Path, *agents: tuple[str, str, str]) -> Stage:
    """A manager for a vehicle, a cloud and further agents: name, role and the capability that each has."""
    stage = Stage(folder, vehicles=1)
    others = [agent for agent in stage.settings.agents if agent.name not in {name for name, _, _ in agents}]
    stage.settings = replace(stage.settings, agents=(*others, *(Agent(name, role, name) for name, role, _ in agents)))
    machines = [machine for machine in stage.cluster.machines if machine.name not in {name for name, _, _ in agents}]
    stage.cluster.machines[:] = [*machines, *(NodeState(n, n, role, frozenset({c}), True) for n, role, c in agents)]
    stage.manager = stage.start()
    stage.settle()
    return stage


@contextmanager
def running_on(folder: Path, manager: Stage, *agents: str) -> Iterator[RunningReleases]:
    """The releases of these agents run."""
    folder.mkdir()
    made = RunningReleases(folder, manager, agents)
    with made.api:
        try:
            yield made
        finally:
            made.close()


def seen(view: View) -> tuple[str, str, bytes]:
    """What a lidar says of what it sees."""
    return cloud_topic(view.agent), CLOUD_TYPE, cloud(view)


def given_to_the_manager(running: RunningReleases, manager: Stage) -> str:
    """The one task of the vehicle's operator, once it is given; its name."""
    until(lambda: running.tasks(VEHICLE), "a task of the vehicle's operator", state=running.logs)
    [(name, task)] = running.tasks(VEHICLE).items()
    manager.tasks.create(VEHICLE, name, task["spec"], created="2026-11-21T10:00:01Z")
    manager.settle()
    assert manager.tasks.condition(f"{VEHICLE}/{name}", "Committed") == ("True", "Merged")
    return name


def test_a_blocked_view_brings_what_the_road_side_unit_sees_to_the_vehicle(tmp_path: Path) -> None:
    manager = fleet_of(tmp_path / "manager", (SITE, "roadside", "lidar"))
    manager.ask("near", application="uncertainty-operator", parameters={"site": SITE, "vehicle": VEHICLE})
    manager.settle()
    with running_on(tmp_path / "robots", manager, VEHICLE, SITE) as running:
        running.follow()
        with running.publishing(VEHICLE, seen(CLEAR)):
            sure = [one.data for one in running.receive(VEHICLE, UNCERTAINTY, NUMBER, 5)]
            assert all(0 < one < BELOW for one in sure), sure
            assert running.tasks(VEHICLE) == {}
        with running.publishing(VEHICLE, seen(BLOCKED)), running.publishing(SITE, seen(SITES)):
            [uncertain, *_] = [one.data for one in running.receive(VEHICLE, UNCERTAINTY, NUMBER, 5)]
            assert uncertain > ABOVE
            name = given_to_the_manager(running, manager)
            running.follow()
            for message in running.receive(VEHICLE, OBJECTS, POSES, 5):
                assert message.header.frame_id == "roadside_0/lidar_center"
                assert hidden_among(SITE, [(pose.position.x, pose.position.y) for pose in message.poses])
            tracks = json.loads(running.receive(VEHICLE, TRACKS, TEXT)[-1].data)["tracks"]
            assert hidden_among(SITE, [(track["x"], track["y"]) for track in tracks])
        with running.publishing(VEHICLE, seen(CLEAR)):
            until(lambda: not running.tasks(VEHICLE), "the demand to end", state=running.logs)
    manager.tasks.delete(f"{VEHICLE}/{name}")
    manager.settle()
    assert not any(f"/{SITE}/object-" in path for path in manager.releases())


def test_what_the_cloud_detects_for_a_vehicle_returns_to_it(tmp_path: Path) -> None:
    """The vehicle's clouds go to the cloud, and the poses in them come back, in the frame of its lidar."""
    manager = fleet_of(tmp_path / "manager", ("cloud-0", "cloud", "perception"))
    parameters, placement = {"sensor": VEHICLE}, {"roles": ["cloud"]}
    manager.ask("offloaded", application="object-detection", parameters=parameters, placement=placement)
    manager.settle()
    assert any("/cloud-0/object-detection-vehicle-00" in path for path in manager.releases())
    ahead = Place(20.0, 4.0, math.pi)
    with running_on(tmp_path / "robots", manager, VEHICLE, "cloud-0") as running:
        running.follow()
        with running.publishing(VEHICLE, (cloud_topic(VEHICLE), CLOUD_TYPE, lidar_clouds.cloud(ahead))):
            [objects] = running.receive(VEHICLE, "/agents/cloud_0/vehicles/vehicle_00/objects", POSES)
    assert objects.header.frame_id == lidar_clouds.FRAME
    [pose] = objects.poses
    assert math.dist((pose.position.x, pose.position.y), lidar_clouds.seen_at(ahead)) < 1.0
