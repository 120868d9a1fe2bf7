"""Environment perception on the road-side unit: one application of two services, asked for, fed with a cloud, with one
of its containers ended, and withdrawn. Played once, for two stories of Table I."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from scenarios.definition import cloud_topic
from scenarios.generator import messages, scene
from scenarios.runner.inputs import Commit
from tests.stages.platform.running_platform import eventually
from tests.stages.platform.table_one import POSES, TEXT, Pod, Stage

SITE = "roadside-0"
DETECTION, TRACKING = f"{SITE}/object-detection-{SITE}", f"{SITE}/object-tracking-{SITE}"
PLACE_M = (10.0, 3.0)  # of the other vehicle, ahead and to the left of the sensor's
MESSAGES = 5


@dataclass(frozen=True)
class RoadsidePerception:
    """What was seen. `task` asked for it; `releases` are those that named it. By release: `pods`, charts and their
    digests that main named, the commits that `made` and that `removed` it. The last objects and tracks of the cloud.
    The tracking's pods after the detection's container was ended and had another one."""

    task: str
    releases: frozenset[str]
    pods: Mapping[str, Pod]
    charts: Mapping[str, str]
    digests: Mapping[str, str]
    made: Mapping[str, Commit]
    objects: Any
    tracks: Sequence[Mapping[str, Any]]
    tracking_after: Sequence[Pod]
    removed: Mapping[str, Commit]


def cloud() -> bytes:
    """What a lidar on a standing vehicle sees of another one."""
    rays = scene.ray_directions(20_000)
    mount = scene.Mount(0.0, 0.0, 1.9, 0.0)
    noise = np.zeros(len(rays), np.float32)
    points = scene.cast(rays, mount, scene.Place(0.0, 0.0, 0.0), [scene.Place(*PLACE_M, 0.0)], noise)
    return messages.CloudWriter("roadside_0/lidar_center", len(rays)).message(0, points)


def play(stage: Stage) -> RoadsidePerception:
    """From the task until both services are gone."""
    task = stage.submit("cloud-0", "perception", application="environment-perception", parameters={"sensor": SITE})
    pods = stage.await_running(DETECTION, TRACKING)
    releases = stage.releases_of(task)
    made = _commits(stage)
    charts, digests = ({pod: stage.annotation(pod, name) for pod in pods} for name in ("chart", "chart-digest"))
    with stage.publishing(TRACKING, (cloud_topic(SITE), messages.CLOUD_TYPE, cloud()), hertz=5):
        [*_, objects] = stage.receive(TRACKING, "/vehicles/roadside_0/objects", POSES, MESSAGES)
        [*_, answer] = stage.receive(DETECTION, "/vehicles/roadside_0/tracks", TEXT, MESSAGES)
    _end(stage, pods[DETECTION])
    tracking_after = stage.pods(TRACKING)
    stage.withdraw(task)
    stage.await_gone(DETECTION, TRACKING)
    return RoadsidePerception(
        task=task,
        releases=frozenset(releases),
        pods=pods,
        charts=charts,
        digests=digests,
        made=made,
        objects=objects,
        tracks=json.loads(answer.data)["tracks"],
        tracking_after=tracking_after,
        removed=_commits(stage),
    )


def _commits(stage: Stage) -> dict[str, Commit]:
    """The last commit that touched each of the two releases."""
    return {release: stage.commit_of(release) for release in (DETECTION, TRACKING)}


def _end(stage: Stage, detection: Pod) -> None:
    """End the detection's container; until another one is ready."""
    stage.platform.kubectl("-n", SITE, "delete", "pod", detection.name, "--grace-period=0", "--force")

    def replaced() -> bool:
        pods = stage.pods(DETECTION)
        return len(pods) == 1 and pods[0].ready and pods[0].uid != detection.uid

    eventually("another container of the detection runs", replaced)
