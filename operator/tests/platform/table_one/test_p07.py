"""Application updates are conducted by updating the individual container images of an application.

Example: The object detection microservice of an environment perception application is updated independently of other
containers of that application.

Story: The detection runs at a road-side unit, as a part of environment perception, and on two vehicles when a version
in another image is published. One commit gives the new image to one of the three agents; once it is healthy there, a
second one gives it to the others. Each of the three pods is a new one in that image, and every other pod of the fleet,
that of the tracking and those of all bridges among them, keeps its identity. (An image that does not start in the field
is taken back: [test_updates](../../operator/tests/platform/cluster/test_updates.py).)

Asserted: on main, which commit gave which releases the new version, and that a later one gave it to the others; on the
pods' images by digest, and on their identities: new ones for the three detections, the same ones for all others.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import takewhile

from ci import publish
from ci.images.image_lock import lock_file, read_lock
from scenarios.runner.platform import proposing
from tests.stages.platform.running_platform import eventually
from tests.stages.platform.table_one import BRIDGE, Stage

CHART = "object-detection"
ROADSIDE = f"roadside-0/{CHART}-roadside-0"
TRACKING = "roadside-0/object-tracking-roadside-0"
VEHICLES = ("vehicle-00", "vehicle-01")
DETECTIONS = {ROADSIDE, *(f"{vehicle}/{CHART}-{vehicle}" for vehicle in VEHICLES)}
OLD, NEW = "0.1.2", "0.2.3"
POLICY = "policies/updates.yaml"
ONE_FIRST = f"charts: {{{CHART}: {{canary: true, successSeconds: 5}}}}\n"
UPDATED_SECONDS_MAX = 180.0


@contextmanager
def spreading(stage: Stage, more: str) -> Iterator[None]:
    """New versions spread as `more` of the policy says, and afterwards as before."""
    stage.deployment.fetch()
    before = stage.deployment.file(POLICY)

    def put(text: str) -> None:
        stage.deployment.fetch()
        proposing.change(stage.deployment, POLICY, text, "policy(updates): a story of Table I", f"p07-{time.time_ns()}")

    put(before + more)
    try:
        yield
    finally:
        put(before)


def test_the_image_of_one_service_is_replaced_on_one_agent_then_on_all(stage: Stage) -> None:
    key = stage.submit(
        "cloud-0", "p07-perception", application="environment-perception", parameters={"sensor": "roadside-0"}
    )
    for vehicle in VEHICLES:
        asked = {"application": CHART, "parameters": {"sensor": vehicle}, "placement": {"agents": [vehicle]}}
        stage.submit("cloud-0", f"p07-{vehicle}", **asked)
    before = stage.await_running(*DETECTIONS, TRACKING)
    assert {stage.annotation(release, "chart-version") for release in before} == {OLD}
    images = {image.name: image.reference for image in read_lock(lock_file())}
    assert {before[release].images for release in DETECTIONS} == {(images["ros"],)}
    neighbours = sorted(set(stage.releases()) - DETECTIONS)
    kept = {name: {pod.uid for pod in stage.pods(name)} for name in neighbours}
    assert TRACKING in kept
    assert any(name.endswith(f"/{BRIDGE}") for name in kept)

    def replaced() -> bool:
        """Everywhere; each pod is another one, in the service's own image."""
        pods = {release: stage.pods(release) for release in DETECTIONS}
        return all(
            len(of_release) == 1 and of_release[0].ready and of_release[0].images == (images[CHART],)
            for of_release in pods.values()
        ) and {stage.annotation(release, "chart-version") for release in DETECTIONS} == {NEW}

    since = stage.commits()[0].sha
    with spreading(stage, ONE_FIRST):
        publish.publish(stage.platform.access.kubeconfig, extra=(CHART,))
        eventually("the detection runs in its new image everywhere", replaced, UPDATED_SECONDS_MAX)
    first, *others = updates(stage, since)
    assert len(first) == 1
    assert set().union(first, *others) == DETECTIONS
    after = {release: pod.uid for release in DETECTIONS for pod in stage.pods(release)}
    assert not {before[release].uid for release in DETECTIONS} & set(after.values())
    assert {name: {pod.uid for pod in stage.pods(name)} for name in neighbours} == kept
    assert stage.annotation(TRACKING, "chart-version") == OLD
    assert stage.releases_of(key) == {ROADSIDE, TRACKING}


def updates(stage: Stage, since: str) -> list[set[str]]:
    """What each commit after `since` that updated one of the detections changed, the oldest first; nothing else may be
    in one."""
    files = {f"releases/{release}.yaml": release for release in DETECTIONS}
    new = takewhile(lambda commit: commit.sha != since, stage.commits())
    commits = [commit for commit in new if commit.trailers.get("Cause") == ("update",)]
    changed = [{path for path in commit.paths if path.startswith("releases/")} for commit in commits]
    ours = [paths for paths in changed if paths & files.keys()]
    assert set().union(*ours) <= files.keys()
    return [{files[path] for path in paths} for paths in reversed(ours)]
