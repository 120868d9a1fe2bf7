"""The provider `kind`: a cluster of containers on this machine, by the kind program alone."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ci import kind_cli
from ci.cluster.api_server import node_states
from ci.cluster.existing.nodes import GivenCluster, GivenNodes
from ci.cluster.kind.command import Kind
from ci.cluster.kind.configuration import CLUSTER, WORKERS, configuration, key, shared_out
from ci.cluster.through_api_server.bundled_images import bundled
from ci.cluster.through_api_server.ways import ReachedThroughApiServer, values_of_built_images
from ci.cluster_contract import sharing
from ci.cluster_contract.provider import ChartProfile, NodeState
from ci.cluster_contract.topology import Topology
from ci.errors import InputError, SetUpError
from ci.folders import user_cache
from ci.images.image_lock import Image
from ci.kind_node_image import engines, naming
from ci.machine import cgroups
from ci.steps import Steps
from robotkube.registry.bundles.adapters.loading import FIRST, load_kind

NODE_IMAGE = "KIND_NODE_IMAGE"
STEPS = 3
API_SERVER_PORT, KUBELET_PORT = 6443, 10250
NOT_PULLED = "failed to pull image"  # kind's words
MENDED = (
    "kind's own image of nodes cannot be pulled here: make kind-node-image builds one, which is then taken; "
    f"{NODE_IMAGE} names another one"
)


class KindCluster(ReachedThroughApiServer):
    """One cluster, whose state is on disk and in the engine; `binaries`: the tool chain's folder, which is looked for
    when nobody names it."""

    kind = "kind"
    name = CLUSTER
    LACKS = (
        "what publishers push to the forge is not pulled by Nodes: images are loaded into them",
        "bags and ledgers are copied by pods in the agents' namespaces, which the inspector names while they are there",
        "Nodes of the role platform get no taint: pods of others may run beside the platform's",
        "weights and outages of Nodes, conditions of the network, CPU time and admission from files are not there: "
        "Nodes are containers of an engine that only kind knows",
    )

    def __init__(self, binaries: Path = Path()) -> None:
        super().__init__(binaries)

    @property
    def lacks(self) -> tuple[str, ...]:
        """See NodesProvider.lacks."""
        states = self.nodes() if self.kubeconfig().exists() else ()
        return (*self.LACKS, *filter(None, (sharing.trial_of(states),)))

    def up(self, topology: Topology, wanted: Sequence[Image]) -> None:
        """See Provider.up."""
        workers = shared_out(topology, os.environ.get(WORKERS, ""))
        steps = Steps(STEPS)
        with steps.step("kind"):
            command = Kind(kind_cli.ensure())
        configured = configuration(workers, cgroups_of_version_1=not cgroups.unified())
        node_image = self._node_image()
        record = self._record()
        with steps.step(f"cluster {CLUSTER}: {len(workers) + 1} containers") as step:
            if record.get("key") == key(configured, node_image) and command.runs() and self._ready():
                step.note = "running, of the same nodes"
            else:
                step.progress(f"of {node_image or 'the image that belongs to this version of kind'}")
                record = self._create(command, configured, node_image)
        with steps.step("images") as step:
            new = [image for image in wanted if image.reference not in record["images"]]
            if new:
                self._load([image for image in wanted if image in new or image.name == FIRST], command)
                self._write_record({**record, "images": sorted(image.reference for image in wanted)})
            step.note = f"{len(new)} loaded" if new else "there"

    def _create(self, command: Kind, configured: str, node_image: str) -> dict[str, Any]:
        if command.runs():
            if not self._record_file.exists():
                raise InputError(
                    f"kind cluster {CLUSTER} is there and was not made here; take it away first: "
                    f"kind delete cluster --name {CLUSTER}"
                )
            command.delete(self.kubeconfig())
        self.work().mkdir(parents=True, exist_ok=True)
        self._write_record({"images": []})  # what is there from now on was made here
        file = self.work() / "kind.yaml"
        file.write_text(configured, encoding="utf-8")
        try:
            command.create(file, self.kubeconfig(), node_image)
        except SetUpError as error:
            if node_image or NOT_PULLED not in str(error):
                raise
            raise SetUpError(f"{error}\n{MENDED}") from error
        record: dict[str, Any] = {"key": key(configured, node_image), "images": []}
        self._write_record(record)
        return record

    def _load(self, wanted: Sequence[Image], command: Kind) -> None:
        """Load images into every Node: kind takes an archive that has each of them whole, under its name."""
        with bundled(wanted, self.work() / "images") as bundle:
            load_kind(bundle, CLUSTER, str(command.program))

    def down(self) -> tuple[str, ...]:
        """See NodesProvider.down."""
        if not self._record_file.exists():
            return ()
        command = Kind(kind_cli.ensure())
        removed = []
        if command.runs():
            command.delete(self.kubeconfig())
            removed.append(f"kind cluster {CLUSTER} with its containers and volumes")
        shutil.rmtree(self.work())
        return (*removed, f"files of {self.work()}")

    def kept(self) -> tuple[str, ...]:
        """See NodesProvider.kept."""
        return ("the image of kind's nodes, which the engine keeps",)

    def nodes(self) -> tuple[NodeState, ...]:
        """See NodesProvider.nodes: those that are agents', by name."""
        return self._given_nodes.states()

    def status(self) -> str:
        """See NodesProvider.status."""
        return node_states.nodes_table(self.nodes())

    def work(self) -> Path:
        """See Provider.work."""
        return user_cache() / "kind-cluster"

    def kubeconfig(self) -> Path:
        """See Provider.kubeconfig."""
        return self.work() / "kubeconfig"

    def chart_profile(self) -> ChartProfile:
        """See Provider.chart_profile. kubeadm has kubelets sign their certificates themselves, so the inspector cannot
        verify them."""
        values = {
            **values_of_built_images(),
            "inspection": {"verifyKubelets": False},
            "networkPolicies": self._addresses(),
            **sharing.platform_values(self._given_nodes.labels()),
        }
        return ChartProfile((), values)

    def _addresses(self) -> Mapping[str, Any]:
        """Addresses at which the API server and kubelets answer, for a network that enforces policies."""
        states = [node for node in self._given_nodes.all_states() if not node.guest]
        every = [{"ipBlock": {"cidr": f"{node.address}/32"}} for node in states]
        control = [one for one, node in zip(every, states, strict=True) if node.name == f"{CLUSTER}-control-plane"]
        return {
            "apiServer": {"to": control, "ports": [API_SERVER_PORT]},
            "kubelets": {"to": every, "ports": [KUBELET_PORT]},
        }

    def machines(self) -> None:
        """See Provider.machines: they are the engine's."""

    @property
    def _given_nodes(self) -> GivenNodes:
        if not self.kubeconfig().exists():
            raise SetUpError(f"kind cluster {CLUSTER} is not running: start it with make cluster CLUSTER=kind")
        return GivenNodes(GivenCluster(str(self.kubeconfig())))

    def _node_image(self) -> str:
        """Of Nodes: the one that is named, else one that was built here of the same sources; empty: the one that
        belongs to kind's version."""
        named = os.environ.get(NODE_IMAGE, "")
        if named or not (engine := engines.found()):
            return named
        built = naming.reference()
        return built if engines.has(engine, built) else ""

    def _ready(self) -> bool:
        try:
            states = self._given_nodes.states()
        except SetUpError:  # its engine was started again
            return False
        return bool(states) and all(node.ready for node in states)

    @property
    def _record_file(self) -> Path:
        return self.work() / "record.json"

    def _record(self) -> dict[str, Any]:
        """What was made and loaded; empty before that."""
        file = self._record_file
        return json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}

    def _write_record(self, record: Mapping[str, Any]) -> None:
        part = self._record_file.with_suffix(".part")
        part.write_text(json.dumps(record), encoding="utf-8")
        part.replace(self._record_file)
