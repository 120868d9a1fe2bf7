"""One node: a network and a mount namespace held by a process, in it containerd, kubelet and kube-proxy.

The mount namespace is the node's own so that its mounts end with its processes, that every node can use the paths fixed
in the programs (/run/containerd, /var/lib/kubelet/device-plugins, /var/lib/cni, /var/log/containers), and that none has
to read the mounts of all the others.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ci.cluster.embedded.control_plane.pki import Authority, node_identity
from ci.cluster.embedded.host.processes import AGAIN, Launcher, Process
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.network.addresses import AddressPlan
from ci.cluster.embedded.nodes import containerd
from ci.cluster_contract.topology import NodeSpec
from ci.errors import SetUpError
from ci.machine import cgroups

# Folders of the host over which a node mounts its own; made (and recorded) where a machine lacks them.
OWN_PLACES = {
    "run": Path("/run"),
    "kubelet": Path("/var/lib/kubelet"),
    "cni-state": Path("/var/lib/cni"),
    "container-links": Path("/var/log/containers"),
}
HOLD = """
while [ $# -gt 1 ]; do mount --bind "$1" "$2"; shift 2; done
echo 1 > /proc/sys/net/ipv4/ip_forward
for family in iptables ip6tables; do
  ! [ -e /proc/sys/net/bridge/bridge-nf-call-$family ] || echo 1 > /proc/sys/net/bridge/bridge-nf-call-$family
done
ip link set lo up
touch "$1"
exec sleep infinity
"""
HOUSEKEEPING_SECONDS = 300  # each reads the open files of every process of the machine, or all its control groups
SYNC_SECONDS = 60  # as kubelets do; a changed Secret is in a pod's files at the latest then, and the cache's life later
# Seventeen nodes on one machine: a program that runs one thing at a time does not wake a second core to look for work.
# Measured in the use case, odd and even vehicles: kubelet 11.7 instead of 14.0, containerd 7.9 instead of 8.9 ms/s.
ALONE = {"GOMAXPROCS": "1"}


@dataclass(frozen=True)
class Node:
    """A node with its number, which fixes its addresses."""

    index: int
    spec: NodeSpec
    plan: AddressPlan
    folders: ClusterFolders

    @property
    def name(self) -> str:
        """The node's name in the cluster."""
        return self.spec.name

    @property
    def address(self) -> str:
        """Its address on the bridge."""
        return str(self.plan.node(self.index))

    @property
    def folder(self) -> Path:
        """Its files."""
        return self.folders.node(self.name)

    @property
    def daemon_weight(self) -> int:
        """Of each of its daemons, among those of the cluster."""
        return self.spec.weight // 4

    @property
    def held(self) -> Path:
        """Exists as soon as the node's namespaces are ready."""
        return self.folder / "held"


def missing_places() -> tuple[Path, ...]:
    """Folders of OWN_PLACES (with their missing parents) that this machine lacks, parents first."""
    wanted = {path for place in OWN_PLACES.values() for path in (*place.parents, place) if not path.exists()}
    return tuple(sorted(wanted))


def hold(node: Node, launcher: Launcher) -> Process:
    """Start the process that holds the node's namespaces; it is ready when `node.held` exists."""
    arguments: list[str] = []
    for name, place in OWN_PLACES.items():
        (node.folder / name).mkdir(parents=True, exist_ok=True)
        arguments += [str(node.folder / name), str(place)]
    prefix = ["/usr/bin/unshare", "--net", "--mount", "--propagation", "slave"]
    return launcher.start(f"{node.name}.node", ["/bin/sh", "-ec", HOLD, "hold", *arguments, str(node.held)], prefix)


def inside(holder: Process) -> list[str]:
    """The words that run a program in the node (nsenter; `ip netns exec` would hide the control groups)."""
    return ["/usr/bin/nsenter", f"--net=/proc/{holder.pid}/ns/net", f"--mount=/proc/{holder.pid}/ns/mnt"]


def start_containerd(node: Node, launcher: Launcher, holder: Process, sandbox: str) -> Process:
    """Start containerd on the node's own root folder, which may hold cloned images already."""
    cni = node.folder / "cni"
    cni.mkdir(parents=True, exist_ok=True)
    (cni / "10-robotkube.conflist").write_text(json.dumps(_cni(node), indent=1), encoding="utf-8")
    configuration = node.folder / "containerd.toml"
    settings = containerd.ContainerdSettings(
        root=node.folder / "containerd",
        state=Path("/run/containerd"),
        sandbox=sandbox,
        runc=launcher.binaries / "runc",
        cni=cni,
        hosts=node.folders.hosts,
    )
    configuration.write_text(settings.toml(), encoding="utf-8")
    command = ["containerd", "--config", str(configuration)]
    return launcher.start(f"{node.name}.containerd", command, inside(holder), ALONE, node.daemon_weight)


def socket_of(holder: Process) -> Path:
    """containerd's socket as seen from the host."""
    return Path("/proc", str(holder.pid), "root", "run", "containerd", "containerd.sock")


def _cni(node: Node) -> dict[str, Any]:
    ranges = [[{"subnet": str(node.plan.pod_subnet(node.index))}]]
    addresses = {
        "type": "host-local",
        "dataDir": str(node.folder / "addresses"),
        "ranges": ranges,
        "routes": [{"dst": "0.0.0.0/0"}],
    }
    # A bridge, not routed pairs: processes of one node find each other by multicast.
    bridge = {"type": "bridge", "bridge": "cni0", "isGateway": True, "hairpinMode": True, "ipam": addresses}
    return {"cniVersion": "1.0.0", "name": "robotkube", "plugins": [bridge]}


def write_credentials(node: Node, authority: Authority) -> None:
    """The kubelet's certificate and kubeconfig."""
    identity = node_identity(node.name, node.address)
    authority.issue(identity)
    authority.write_kubeconfig(identity, f"https://{node.plan.gateway}:6443", node.folder / "kubeconfig")


def start_kubelet(node: Node, launcher: Launcher, holder: Process) -> Process:
    """Start kubelet; it registers the node with its labels and taints."""
    configuration = node.folder / "kubelet.yaml"
    root = cgroups.node_root(node.folders.name, node.name, node.spec.weight)
    configuration.write_text(json.dumps(_kubelet(node, root), indent=1), encoding="utf-8")
    (node.folder / "resolv.conf").write_text(f"nameserver {node.plan.gateway}\n", encoding="utf-8")
    labels = ",".join(f"{key}={value}" for key, value in node.spec.labels.items())
    command = [
        "kubelet",
        f"--config={configuration}",
        f"--kubeconfig={node.folder / 'kubeconfig'}",
        f"--hostname-override={node.name}",
        f"--node-ip={node.address}",
        f"--node-labels={labels}",
        f"--root-dir={OWN_PLACES['kubelet']}",
        f"--housekeeping-interval={HOUSEKEEPING_SECONDS}s",
        f"--global-housekeeping-interval={HOUSEKEEPING_SECONDS}s",
        "--v=1",
    ]
    return launcher.start(f"{node.name}.kubelet", command, inside(holder), ALONE, node.daemon_weight)


def _kubelet(node: Node, cgroup_root: str) -> dict[str, Any]:
    pki = node.folders.pki
    return {
        "apiVersion": "kubelet.config.k8s.io/v1beta1",
        "kind": "KubeletConfiguration",
        "syncFrequency": f"{SYNC_SECONDS}s",
        "address": node.address,
        "authentication": {
            "anonymous": {"enabled": False},
            "webhook": {"enabled": True},
            "x509": {"clientCAFile": str(pki / "ca.crt")},
        },
        "authorization": {"mode": "Webhook"},
        "tlsCertFile": str(pki / f"{node.name}.crt"),
        "tlsPrivateKeyFile": str(pki / f"{node.name}.key"),
        "registerWithTaints": list(node.spec.taints),
        "clusterDNS": [str(node.plan.gateway)],
        "clusterDomain": "cluster.local",
        "resolvConf": str(node.folder / "resolv.conf"),
        "containerRuntimeEndpoint": "unix:///run/containerd/containerd.sock",
        "podLogsDir": str(node.folder / "pod-logs"),
        "cgroupDriver": "cgroupfs",
        "cgroupRoot": cgroup_root,
        "failCgroupV1": False,
        "failSwapOn": False,
        "oomScoreAdj": 0,  # a lower one needs a capability that some machines withhold
        "enforceNodeAllocatable": ["pods"],
        "systemReserved": reserved(node.spec),
        "makeIPTablesUtilChains": False,
        "serializeImagePulls": False,
        # All nodes share one disk: none may empty it of images, all would give up together.
        "imageGCHighThresholdPercent": 100,
        "evictionHard": {"nodefs.available": "1%"},
        "nodeStatusUpdateFrequency": "30s",
        "nodeStatusReportFrequency": "5m",  # when nothing changed; its lease says that a node is alive
        "volumeStatsAggPeriod": "10m",
        "shutdownGracePeriod": "0s",
    }


def reserved(spec: NodeSpec) -> dict[str, str]:
    """What the machine has beyond the node's capacity, as kubelet's systemReserved; refuses more than there is."""
    cpu = (os.cpu_count() or 1) * 1000 - spec.cpu_millicores
    memory = _machine_memory_bytes() - spec.memory_bytes
    if cpu < 0 or memory < 0:
        what = f"{-cpu} millicores" if cpu < 0 else f"{-memory} bytes of memory"
        raise SetUpError(
            f"node {spec.name}: its capacity is {what} more than this machine has; lower it in the topology"
        )
    return {"cpu": f"{cpu}m", "memory": str(memory)}


def _machine_memory_bytes() -> int:
    for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
        if line.startswith("MemTotal:"):
            return int(line.split()[1]) * 1024
    raise SetUpError("/proc/meminfo does not say how much memory there is")


def start_proxy(node: Node, launcher: Launcher, holder: Process) -> Process:
    """Start kube-proxy, which makes the Services' addresses work in the node's network namespace."""
    configuration = node.folder / "kube-proxy.yaml"
    configuration.write_text(json.dumps(_proxy(node), indent=1), encoding="utf-8")
    command = ["kube-proxy", f"--config={configuration}"]
    # kube-proxy 1.36 now and then panics while it starts (it registers a handler with an informer that runs already),
    # and exits on purpose when its node changes: whoever runs it is to start it again, as a DaemonSet does.
    prefix = [*inside(holder), "/bin/sh", "-c", AGAIN, "again"]
    return launcher.start(f"{node.name}.kube-proxy", command, prefix, ALONE, node.daemon_weight)


def _proxy(node: Node) -> dict[str, Any]:
    return {
        "apiVersion": "kubeproxy.config.k8s.io/v1alpha1",
        "kind": "KubeProxyConfiguration",
        "mode": "nftables",
        "hostnameOverride": node.name,
        "clientConnection": {"kubeconfig": str(node.folders.base / "proxy.kubeconfig")},
        "clusterCIDR": str(node.plan.pods),
        "detectLocalMode": "ClusterCIDR",
        "healthzBindAddress": "127.0.0.1:10256",
        "metricsBindAddress": "127.0.0.1:10249",
        "conntrack": {"maxPerCore": 0},
        "oomScoreAdj": 0,
    }


def nodes_of(specs: Iterable[NodeSpec], plan: AddressPlan, folders: ClusterFolders) -> tuple[Node, ...]:
    """Number the nodes."""
    return tuple(Node(index, spec, plan, folders) for index, spec in enumerate(specs))
