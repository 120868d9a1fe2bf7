"""A node of the embedded cluster without a cluster: its containerd, and a kubelet that runs the pods of a folder.

Nothing of it has a name outside: it has namespaces of its own, and folders of the machine that it uses are empty ones
of its own there.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ci.cluster.embedded.host import processes, runc_records
from ci.cluster.embedded.host.processes import Launcher, Process
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.network.addresses import plan_of
from ci.cluster.embedded.nodes import image_imports, node_processes
from ci.cluster.embedded.nodes.node_processes import ALONE, OWN_PLACES, Node
from ci.cluster_contract.topology import NodeSpec
from ci.images import image_lock
from ci.machine import cgroups
from tests.stages.programs import folder as programs
from tests.stages.waiting import until

CLUSTER = "lone"  # never the name of one that may run: its processes would be killed
NAME = "vehicle-00"
NAMESPACES = ("default", "k8s.io")  # of the runtime, that tests use
MIB = 2**20
OF_A_CLUSTER = {"authentication", "authorization", "tlsCertFile", "tlsPrivateKeyFile", "registerWithTaints"}
HOLD = """
mount -t tmpfs tmpfs /var/lib; mount -t tmpfs tmpfs /var/log
while [ $# -gt 1 ]; do mkdir -p "$2"; mount --bind "$1" "$2"; shift 2; done
ip link set lo up
touch "$1"
exec sleep infinity
"""


@dataclass(frozen=True)
class LoneNode:
    """A node that runs. `lock`: the images that it has."""

    node: Node
    launcher: Launcher
    holder: Process
    lock: tuple[image_lock.Image, ...]

    @property
    def folders(self) -> ClusterFolders:
        """Where its cluster's records are."""
        return self.node.folders

    def reference(self, image: str) -> str:
        """The reference of one of its images."""
        return next(one.reference for one in self.lock if one.name == image)

    def ctr(self, *words: str) -> str:
        """What `ctr` says on the node's own socket."""
        command = [str(programs() / "ctr"), "--address", str(node_processes.socket_of(self.holder)), *words]
        done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def run_pod(self, name: str, spec: dict[str, Any]) -> Path:
        """Let the kubelet run a pod; its file, which ends the pod when it is removed."""
        metadata = {"name": name, "namespace": NAME}
        document = {"apiVersion": "v1", "kind": "Pod", "metadata": metadata, "spec": {"hostNetwork": True, **spec}}
        path = self.pods / f"{name}.json"
        path.write_text(json.dumps(document), encoding="utf-8")
        return path

    @property
    def pods(self) -> Path:
        """The folder of its kubelet's pods."""
        return self.node.folder / "static-pods"

    def start_kubelet(self) -> None:
        """Start a kubelet without an API server."""
        self.pods.mkdir()
        root = cgroups.node_root(CLUSTER, self.node.name, self.node.spec.weight)
        as_of_a_cluster = node_processes._kubelet(self.node, root)
        settings = {key: value for key, value in as_of_a_cluster.items() if key not in OF_A_CLUSTER}
        settings |= {"enableServer": False, "staticPodPath": str(self.pods), "fileCheckFrequency": "1s"}
        settings |= {"authentication": {"webhook": {"enabled": False}}, "authorization": {"mode": "AlwaysAllow"}}
        configuration = self.node.folder / "kubelet.yaml"
        configuration.write_text(json.dumps(settings), encoding="utf-8")
        (self.node.folder / "resolv.conf").write_text("", encoding="utf-8")
        command = ["kubelet", f"--config={configuration}", f"--hostname-override={self.node.name}", "--v=1"]
        prefix = node_processes.inside(self.holder)
        self.launcher.start(f"{self.node.name}.kubelet", command, prefix, ALONE)


@contextlib.contextmanager
def lone_node(lock: Path) -> Iterator[LoneNode]:
    """A node with its containerd and these images, without a kubelet; everything of it ends with the context."""
    with tempfile.TemporaryDirectory(prefix="rk-") as cache, _cache(cache):
        try:
            yield _started(ClusterFolders(CLUSTER), image_lock.read_lock(lock))
        finally:
            assert not processes.kill_all(CLUSTER)
            _remove_groups()


def _remove_groups() -> None:
    assert not cgroups.remove(CLUSTER)
    assert not cgroups.remove_foreign(runc_records.foreign_groups(ClusterFolders(CLUSTER).nodes, CLUSTER))
    remove_groups_of_namespaces()


def remove_groups_of_namespaces() -> None:
    """Remove the control groups that a runtime made for its namespaces, where they are empty."""
    for place in cgroups.hierarchies():
        for namespace in NAMESPACES:
            with contextlib.suppress(OSError):
                (place / namespace).rmdir()


@contextlib.contextmanager
def _cache(folder: str) -> Iterator[None]:
    before = os.environ.get("XDG_CACHE_HOME")
    os.environ["XDG_CACHE_HOME"] = folder
    try:
        yield
    finally:
        del os.environ["XDG_CACHE_HOME"]
        os.environ |= {} if before is None else {"XDG_CACHE_HOME": before}


def _started(folders: ClusterFolders, lock: tuple[image_lock.Image, ...]) -> LoneNode:
    spec = NodeSpec(NAME, "vehicle", NAME, 500, 256 * MIB, ())
    node = Node(0, spec, plan_of("test"), folders)
    launcher = Launcher(folders, programs())
    started = LoneNode(node, launcher, _held(node, launcher), lock)
    runtime = node_processes.start_containerd(node, launcher, started.holder, image_lock.sandbox_of(lock))
    socket = node_processes.socket_of(started.holder)
    processes.wait_until(lambda: image_imports.serving(socket, programs()), "containerd", 30, [runtime])
    for image in lock:
        image_imports.import_one(image, socket, programs())
    return started


def _held(node: Node, launcher: Launcher) -> Process:
    arguments = []
    for name, place in OWN_PLACES.items():
        (node.folder / name).mkdir(parents=True)
        arguments += [str(node.folder / name), str(place)]
    prefix = ["/usr/bin/unshare", "--net", "--mount", "--propagation", "private"]
    words = ["/bin/sh", "-ec", HOLD, "hold", *arguments, str(node.held)]
    holder = launcher.start(f"{node.name}.node", words, prefix)
    until(node.held.exists, f"the node's namespaces: {holder.last_lines()}")
    return holder
