"""Applications are in principle node agnostic.

Example: If one node is unavailable, an application may be deployed to a different node capable of running the
application.

Story: A detection may run on a road-side unit or on an edge server. The machine it runs on is ended; it runs on the
other one, and the commit that moved it says which node was lost and for how long. When the machine is back there is
still only one.

Asserted: on the pods' Nodes, where it ran and runs; on main, that one release answers the task, and that the commit's
trailer and message say which Node was lost; on the pods, that there is one when the machine is back.
"""

from __future__ import annotations

import pytest

from tests.stages.platform.running_platform import eventually
from tests.stages.platform.table_one import Stage

pytestmark = pytest.mark.thorough

NAME = "object-detection-roadside-0"
OTHER = {"roadside-0": "edge-0", "edge-0": "roadside-0"}
MOVED_SECONDS_MAX = 180.0  # 50 s until Kubernetes says that the node is not ready, 10 s until it counts as lost


def test_what_ran_on_a_lost_node_runs_on_another(stage: Stage) -> None:
    key = stage.submit(
        "cloud-0",
        "p06-anywhere",
        application="object-detection",
        parameters={"sensor": "roadside-0"},
        placement={"roles": ["roadside", "edge"]},
    )
    [release] = stage.await_releases_of(key)
    pod = stage.await_running(release)[release]
    lost = release.partition("/")[0]
    moved = f"{OTHER[lost]}/{NAME}"
    with stage.stopped(pod.node):
        moved_pod = stage.await_running(moved, seconds=MOVED_SECONDS_MAX)[moved]
        assert stage.node_labels(moved_pod.node)["robotkube.io/agent"] == OTHER[lost]
        assert stage.releases_of(key) == {moved}
        commit = stage.commit_of(moved)
        assert "node" in commit.trailers["Cause"]
        assert f"node {pod.node} lost for " in stage.message(commit)
        assert OTHER[lost] in stage.message(commit)
        assert f"releases/{release}.yaml" in commit.paths
    eventually("the pod on the node that was lost is gone", lambda: stage.pods(release) == [])
    assert [one.uid for one in stage.pods(moved)] == [moved_pod.uid]
