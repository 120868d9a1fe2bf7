"""A node that joins a cluster which runs, as a machine does that is switched on later.

The next `up` makes the cluster anew: it is no longer what its topology says.
"""

from __future__ import annotations

from collections.abc import Sequence

from ci.cluster.api_server import node_states
from ci.cluster.api_server.client import Api
from ci.cluster.embedded import first_objects
from ci.cluster.embedded.control_plane.pki import Authority
from ci.cluster.embedded.host.processes import Launcher, Process, recorded, wait_until
from ci.cluster.embedded.host.records import Record
from ci.cluster.embedded.network import host_network
from ci.cluster.embedded.network.addresses import plan_of
from ci.cluster.embedded.network_policies import enforcement
from ci.cluster.embedded.nodes import image_imports, node_processes
from ci.cluster.embedded.nodes.node_processes import Node
from ci.cluster_contract.topology import NodeSpec
from ci.errors import InputError
from ci.images import image_lock

HOLD_SECONDS_MAX = 15
CONTAINERD_SECONDS_MAX = 60
READY_SECONDS_MAX = 120


def join(launcher: Launcher, api: Api, spec: NodeSpec, wanted: Sequence[image_lock.Image]) -> None:
    """Start the machine of `spec` with the images `wanted`; it is Ready afterwards. InputError when there is one of
    that name."""
    folders = launcher.folders
    others = [process for process in recorded(folders) if process.name.endswith(".node")]
    if f"{spec.name}.node" in {process.name for process in others}:
        raise InputError(f"cluster {folders.name} has a node {spec.name} already: give another name")
    node_processes.reserved(spec)
    node = Node(len(others), spec, plan_of(folders.name), folders)
    record = Record.read(folders.record)
    record.complete = False
    record.write(folders.record)
    node.folder.mkdir(parents=True)
    node_processes.write_credentials(node, Authority(folders.pki))
    holder = _connected(node, launcher, others)
    _running(node, launcher, holder, wanted)
    first_objects.create(api, (node,))
    culprits = [process for process in recorded(folders) if process.name.startswith(f"{spec.name}.")]
    wait_until(lambda: _ready(api, spec.name), f"node {spec.name} Ready", READY_SECONDS_MAX, culprits)


def _connected(node: Node, launcher: Launcher, others: Sequence[Process]) -> Process:
    holder = node_processes.hold(node, launcher)
    wait_until(node.held.exists, "namespaces", HOLD_SECONDS_MAX, [holder])
    host_network.join(node.plan, node.index, holder.pid, [process.pid for process in others])
    if enforcement.followed(launcher.folders):
        enforcement.close(holder)
    return holder


def _running(node: Node, launcher: Launcher, holder: Process, wanted: Sequence[image_lock.Image]) -> None:
    root, _ = image_imports.imported(wanted, launcher)
    image_imports.clone(root, node.folder / "containerd")
    runtime = node_processes.start_containerd(node, launcher, holder, image_lock.sandbox_of(wanted))
    socket = node_processes.socket_of(holder)
    wait_until(socket.exists, "containerd", CONTAINERD_SECONDS_MAX, [runtime])
    node_processes.start_kubelet(node, launcher, holder)
    node_processes.start_proxy(node, launcher, holder)


def _ready(api: Api, name: str) -> bool:
    return any(node.name == name and node.ready for node in node_states.nodes(api))
