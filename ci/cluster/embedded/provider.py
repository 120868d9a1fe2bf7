"""The provider `embedded`: a Kubernetes cluster of this machine's processes, one network namespace per node."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TypeVar

from ci.cluster.api_server import node_states
from ci.cluster.api_server.client import Api
from ci.cluster.embedded import cleaning, first_objects, joining, outages, status
from ci.cluster.embedded.admission import admission_files
from ci.cluster.embedded.containers import reports
from ci.cluster.embedded.control_plane import programs
from ci.cluster.embedded.control_plane.pki import Authority
from ci.cluster.embedded.disk_volumes import DiskVolumes
from ci.cluster.embedded.emulation import emulating
from ci.cluster.embedded.host.processes import Launcher, Process, recorded, wait_until
from ci.cluster.embedded.host.records import ClusterFolders, Record, one_at_a_time
from ci.cluster.embedded.network import host_network
from ci.cluster.embedded.network.addresses import PLANS, AddressPlan, plan_of
from ci.cluster.embedded.network_policies import enforcement
from ci.cluster.embedded.nodes import image_imports, node_processes, pulling
from ci.cluster.embedded.nodes.node_processes import Node
from ci.cluster_contract.provider import ChartProfile, NodeState, ServicePort, WayOfAPerson, directly
from ci.cluster_contract.topology import NodeSpec, Topology
from ci.errors import SetUpError
from ci.folders import PROJECT
from ci.images import image_lock
from ci.machine import cgroups, network_policies
from ci.steps import Step, Steps

STEPS = 7
API_TIMEOUT_SECONDS = 60
HOLD_TIMEOUT_SECONDS = 15
CONTAINERD_TIMEOUT_SECONDS = 60
READY_TIMEOUT_SECONDS = 120
PARALLEL = 4
T = TypeVar("T")
# A cluster that runs was made by these modules as they are now, or it is made anew.
DEFINING = (
    "machine/cgroups",
    "machine/network_policies",
    *(
        f"cluster/embedded/{module}"
        for module in (
            "admission/admission_files",
            "containers/beside_kubelets",
            "containers/polling",
            "containers/node_containers",
            "containers/reports",
            "control_plane/pki",
            "control_plane/programs",
            "first_objects",
            "network/addresses",
            "network/host_network",
            "nodes/containerd",
            "nodes/node_processes",
        )
    ),
)


class Embedded:
    """One cluster by name; its state is on disk, so any process may make this object. `admission_choice`: see
    `admission_files.choice`; whether network policies are enforced: see `network_policies.choice`."""

    kind = "embedded"
    lacks: tuple[str, ...] = ()

    def __init__(self, name: str, binaries: Path, admission_choice: str = "") -> None:
        self.name = name
        self.admission = admission_files.choice(admission_choice)
        self.network_policies = network_policies.choice()
        self.plan: AddressPlan = plan_of(name)
        self.folders = ClusterFolders(name)
        self.binaries = binaries
        self.launcher = Launcher(self.folders, binaries)

    def up(self, topology: Topology, wanted: Sequence[image_lock.Image]) -> None:
        """See Provider.up. A start that fails leaves its logs and is removed by the next `up` or `down`."""
        with one_at_a_time():
            self._up(topology, wanted)

    def _up(self, topology: Topology, wanted: Sequence[image_lock.Image]) -> None:
        steps = Steps(STEPS)
        emulating.clear(self.plan, self.folders)
        record = Record.read(self.folders.record)
        if self._reusable(record, topology):
            with steps.step(f"cluster {self.name}: running, of the same topology") as step:
                self._import_new(wanted, step)
            return
        with steps.step("remove what is left of earlier starts") as step:
            self._stop_others(step)
            cleaning.remove(self.name, keep_logs=False)
        self._start(topology, wanted, steps)

    def down(self) -> tuple[str, ...]:
        """See Provider.down."""
        with one_at_a_time():
            return cleaning.remove(self.name)

    def kept(self) -> tuple[str, ...]:
        """See Provider.kept."""
        return (f"the logs in {self.folders.log}",)

    def status(self) -> str:
        """See Provider.status."""
        table = status.table(self.name, self.api(), recorded(self.folders))
        return f"{table}\n\n{reports.status(self.folders)}\n{enforcement.status(self.folders)}"

    def kubeconfig(self) -> Path:
        """See Provider.kubeconfig."""
        return self.folders.kubeconfig

    def work(self) -> Path:
        """See Provider.work."""
        return self.folders.base / "values"

    def chart_profile(self) -> ChartProfile:
        """See Provider.chart_profile."""
        return ChartProfile(("values-embedded.yaml",), {"suites": {"pool": first_objects.SUITE_NAMESPACES}})

    def reach(self, service: ServicePort) -> tuple[str, int]:
        """See Provider.reach."""
        return directly(service)

    def way_of_a_person(self, service: ServicePort) -> WayOfAPerson:
        """See Provider.way_of_a_person."""
        return WayOfAPerson(*directly(service))

    @contextmanager
    def volumes(self) -> Iterator[DiskVolumes]:
        """See Provider.volumes."""
        yield DiskVolumes(self.api())

    def machines(self) -> Embedded:
        """See Provider.machines."""
        return self

    def cpu_folder(self) -> Path:
        """See OwnMachines.cpu_folder."""
        base = cgroups.ROOT if cgroups.unified() else (cgroups.ROOT / cgroups.ACCOUNTING).resolve()
        return base / cgroups.top(self.name)

    def api(self) -> Api:
        """A connection as administrator; raises SetUpError when there is no cluster."""
        if not self.folders.kubeconfig.exists():
            raise SetUpError(f"cluster {self.name} is not running: start it with make cluster")
        return Api(str(self.plan.gateway), self.folders.pki)

    def nodes(self) -> tuple[NodeState, ...]:
        """See Provider.nodes."""
        return node_states.nodes(self.api())

    def import_images(self, wanted: Sequence[image_lock.Image]) -> None:
        """Make images known to every node under their digest references."""
        admission_files.add(self.folders, images=wanted)
        sockets = [
            node_processes.socket_of(process) for process in recorded(self.folders) if process.name.endswith(".node")
        ]
        jobs = [(image, socket) for image in wanted for socket in sockets]
        _in_parallel(lambda job: image_imports.import_one(job[0], job[1], self.binaries), jobs)

    def pull_from(self, url: str, username: str, password: str, authorities: str = "") -> None:
        """See OwnMachines.pull_from."""
        pulling.allow(self.folders.hosts, url, username, password, authorities)

    def stop_node(self, name: str) -> None:
        """End a node's machine with everything on it, as a loss of power would; it stays registered."""
        outages.stop(self.name, name)

    def start_node(self, name: str) -> None:
        """Let a stopped node come back."""
        outages.start(self.name, name)

    def emulator(self) -> emulating.NetworkEmulation:
        """See OwnMachines.emulator."""
        return emulating.NetworkEmulation(self.plan, self.launcher, self.nodes)

    def join(self, spec: NodeSpec, wanted: Sequence[image_lock.Image]) -> None:
        """Add a node to the running cluster; see joining.join."""
        with one_at_a_time():
            admission_files.add(self.folders, [spec.agent], wanted)
            joining.join(self.launcher, self.api(), spec, wanted)

    def volume_path(self, namespace: str, volume_claim: str) -> Path:
        """The host's folder behind a bound volume claim."""
        return first_objects.volume_path(self.api(), namespace, volume_claim)

    def _reusable(self, record: Record, topology: Topology) -> bool:
        if not record.complete or record.specification != self._specification(topology):
            return False
        processes = recorded(self.folders)
        if not processes or not all(process.alive() for process in processes):
            return False
        api = self.api()
        return api.ready() and all(node.ready for node in node_states.nodes(api))

    def _specification(self, topology: Topology) -> str:
        parts = [str(self.binaries), *self._rules(topology), json.dumps([asdict(node) for node in topology.nodes])]
        parts += [(PROJECT / "ci" / f"{module}.py").read_text(encoding="utf-8") for module in DEFINING]
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()

    def _rules(self, topology: Topology) -> list[str]:
        """What is enforced: other rules are another cluster."""
        from_files = self.admission == admission_files.FILES
        admitted = admission_files.rules(self.folders, topology) if from_files else [self.admission]
        return [*admitted, *enforcement.rules(self.network_policies)]

    def _import_new(self, wanted: Sequence[image_lock.Image], step: Step) -> None:
        record = Record.read(self.folders.record)
        new = [image for image in wanted if record.images.get(image.name) != image.reference]
        self.import_images(new)
        record.images.update({image.name: image.reference for image in new})
        record.write(self.folders.record)
        step.note = f"{len(new)} new images"

    def _stop_others(self, step: Step) -> None:
        for other in PLANS:
            if other != self.name and cleaning.leftovers(other):
                step.progress(f"stopping the cluster {other}: only one can run at a time")
                cleaning.remove(other)

    def _start(self, topology: Topology, wanted: Sequence[image_lock.Image], steps: Steps) -> None:
        placed = node_processes.nodes_of(topology.nodes, self.plan, self.folders)
        for node in placed:
            node_processes.reserved(node.spec)
        record = Record(self._specification(topology))
        with steps.step(f"images for {len(placed)} nodes") as step:
            root, count = image_imports.imported(wanted, self.launcher)
            step.note = f"{count} of {len(wanted)} imported" if count else "cached"
        with steps.step("certificates"):
            self._credentials(placed)
        with steps.step("network"):
            holders = self._network(placed, record)
        with steps.step("control plane and containerd"):
            kernel = self._control_plane(topology, wanted)
            runtimes = self._runtimes(placed, holders, root, image_lock.sandbox_of(wanted))
            wait_until(self.api().ready, "the API server", API_TIMEOUT_SECONDS, kernel)
            programs.start_controllers(self.launcher, self.plan)
            if self.admission == admission_files.FILES:
                admission_files.start_controller(self.launcher)
            if self.network_policies == network_policies.ON:
                enforcement.start_controller(self.launcher)
            reports.start_polling(self.launcher)
        with steps.step("kubelets, name service, volumes"):
            self._kubelets(placed, holders, runtimes)
            with self.api() as api:
                first_objects.create(api, placed)
            programs.start_name_service(self.launcher, self.plan)
        with steps.step(f"{len(placed)} nodes Ready"):
            self._wait_ready(len(placed))
        record.images = {image.name: image.reference for image in wanted}
        record.complete = True
        record.write(self.folders.record)

    def _credentials(self, placed: Sequence[Node]) -> None:
        self.folders.base.mkdir(parents=True, exist_ok=True)
        authority = Authority(self.folders.pki)
        programs.write_credentials(authority, self.plan, self.folders)
        for node in placed:
            node.folder.mkdir(parents=True)
        _in_parallel(lambda node: node_processes.write_credentials(node, authority), placed)

    def _network(self, placed: Sequence[Node], record: Record) -> list[Process]:
        missing = node_processes.missing_places()
        record.made_folders = [str(path) for path in missing]
        host_network.set_sysctls(record, self.folders.record)
        for path in missing:
            path.mkdir()
        host_network.create_bridge(self.plan)
        holders = [node_processes.hold(node, self.launcher) for node in placed]
        wait_until(lambda: all(node.held.exists() for node in placed), "namespaces", HOLD_TIMEOUT_SECONDS, holders)
        host_network.connect(self.plan, [holder.pid for holder in holders])
        if self.network_policies == network_policies.ON:
            _in_parallel(enforcement.close, holders)
        return holders

    def _control_plane(self, topology: Topology, wanted: Sequence[image_lock.Image]) -> list[Process]:
        enforced = self.admission == admission_files.FILES
        options = admission_files.prepare(self.folders, topology, wanted) if enforced else {}
        kernel = [programs.start_etcd(self.launcher, self.plan)]
        kernel.append(programs.start_api_server(self.launcher, self.plan, options))
        return kernel

    def _runtimes(self, placed: Sequence[Node], holders: Sequence[Process], root: Path, sandbox: str) -> list[Process]:
        runtimes = []
        for node, holder in zip(placed, holders, strict=True):
            image_imports.clone(root, node.folder / "containerd")
            runtimes.append(node_processes.start_containerd(node, self.launcher, holder, sandbox))
        return runtimes

    def _kubelets(self, placed: Sequence[Node], holders: Sequence[Process], runtimes: Sequence[Process]) -> None:
        sockets = [node_processes.socket_of(holder) for holder in holders]
        wait_until(
            lambda: all(socket.exists() for socket in sockets), "containerd", CONTAINERD_TIMEOUT_SECONDS, runtimes
        )
        for node, holder in zip(placed, holders, strict=True):
            node_processes.start_kubelet(node, self.launcher, holder)
            node_processes.start_proxy(node, self.launcher, holder)

    def _wait_ready(self, count: int) -> None:
        def ready() -> bool:
            nodes = self.nodes()
            return len(nodes) == count and all(node.ready for node in nodes)

        wait_until(ready, "all nodes Ready", READY_TIMEOUT_SECONDS, recorded(self.folders))


def _in_parallel(work: Callable[[T], None], items: Sequence[T]) -> None:
    """Do `work` on all items; the first error is raised."""
    with ThreadPoolExecutor(PARALLEL) as pool:
        for _ in pool.map(work, items):
            pass
