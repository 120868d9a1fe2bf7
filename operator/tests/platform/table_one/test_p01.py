"""Connected agents make at least some of their compute units available as nodes to a Kubernetes cluster.

Example: A C-ITS cluster consists of nodes in the cloud, on edge servers, in control centers, in sensored road side
units, and in automated vehicles.

Story: Machines of every role are nodes of one cluster, each labelled with its agent. The same service is asked for in
the cloud, on an edge server, on a road-side unit and on a vehicle; every pod of every release runs on its agent's node.

Asserted: on the cluster's Nodes and their labels, that every pod of a release runs on a Node of its release's agent,
for every release on main; for the four that were asked for, that the Node has the role, too.
"""

from __future__ import annotations

from tests.stages.platform.table_one import Stage

SENSORS = {"cloud": "vehicle-00", "edge": "vehicle-01", "roadside": "roadside-0", "vehicle": "vehicle-02"}
AGENTS = {"cloud": "cloud-0", "edge": "edge-0", "roadside": "roadside-0", "vehicle": "vehicle-02"}


def test_every_role_offers_nodes_and_takes_services(stage: Stage) -> None:
    ready = {node.role for node in stage.platform.provider.nodes() if node.ready}
    assert ready == {"platform", *SENSORS}
    keys = {
        role: stage.submit(
            "cloud-0",
            f"p01-on-{role}",
            application="object-detection",
            parameters={"sensor": sensor},
            placement={"roles": [role]} | ({"agents": [sensor]} if role == "vehicle" else {}),
        )
        for role, sensor in SENSORS.items()
    }
    for role, key in keys.items():
        [release] = stage.await_releases_of(key)
        pod = stage.await_running(release)[release]
        agent, _, name = release.partition("/")
        assert name == f"object-detection-{SENSORS[role]}"
        assert agent == AGENTS[role]
        labels = stage.node_labels(pod.node)
        assert (labels["robotkube.io/role"], labels["robotkube.io/agent"]) == (role, agent)


def test_every_release_on_main_runs_on_a_node_of_its_agent(stage: Stage) -> None:
    releases = stage.releases()
    assert {name.partition("/")[0] for name in releases} >= {"cloud-0", "vehicle-00", "vehicle-01", "vehicle-02"}
    for release in releases:
        for pod in stage.pods(release):
            assert stage.node_labels(pod.node)["robotkube.io/agent"] == release.partition("/")[0]
