"""Processes of ROS 2 in two pods between which nothing goes that is for many: they find each other by what each passes
on, and by nothing else."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from benchmarks.measuring import pods
from ci.folders import PROJECT

pytestmark = pytest.mark.processes

MESSENGER = "tests.stages.ros.routed_messenger"
ENVIRONMENT = {"PYTHONPATH": f"{PROJECT / 'operator' / 'src'}:{PROJECT / 'operator'}:{PROJECT}"}
END_SECONDS_MAX = 60


def without_multicast(nodes: pods.Nodes, pod: str) -> None:
    """Have the bridge bring a pod what is for that one, and who asks for an address."""
    link = f"{nodes.prefix}v{pod.rpartition('p')[2]}"
    subprocess.run(["ip", "link", "set", link, "type", "bridge_slave", "mcast_flood", "off"], check=True)


def test_two_pods_without_multicast_hear_each_other(tmp_path: Path) -> None:
    nodes = pods.Nodes()
    started = []
    try:
        node = nodes.node()
        names = [nodes.pod(node) for _ in range(2)]
        for name in names:
            without_multicast(nodes, name)
        addresses = [nodes.address(node, name) for name in names]
        for name, own, peer in zip(names, addresses, reversed(addresses), strict=True):
            command = pods.python(MESSENGER, own, peer)
            started.append(pods.start(name, command, ENVIRONMENT, tmp_path / name, name))
        codes = [one.process.wait(END_SECONDS_MAX) for one in started]
        logs = [(tmp_path / name).read_text() for name in names]
        assert codes == [0, 0], logs
        assert [log.splitlines()[0] for log in logs] == ["before: 0"] * 2
    finally:
        for one in started:
            one.stop()
        nodes.close()
