"""Ways into a cluster of which this machine surely reaches the API server alone: forwards to Services, files by pods,
and what the platform's chart is told of images that were built here."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from ci import toolchain
from ci.cluster.through_api_server.forwards import HOST, Forwards
from ci.cluster.through_api_server.pod_volumes import PodVolumes
from ci.cluster_contract.provider import NodeState, ServicePort, WayOfAPerson
from ci.folders import PROJECT
from ci.images import image_lock
from ci.installation import moved

OF_BUILT_IMAGES = PROJECT / "charts" / "robotkube" / "values-embedded.yaml"
IMAGE_OF_VOLUMES = "ros"  # those of agents' applications stand on it, so their Nodes have its layers


class ReachedThroughApiServer(ABC):
    """The part of a provider that is the same wherever only the API server is reached; forwards end with the process.
    `binaries`: the tool chain's folder, which is looked for when nobody names it."""

    def __init__(self, binaries: Path) -> None:
        self._named_binaries = binaries

    @abstractmethod
    def kubeconfig(self) -> Path:
        """See Provider.kubeconfig."""

    @abstractmethod
    def work(self) -> Path:
        """See Provider.work."""

    @abstractmethod
    def nodes(self) -> tuple[NodeState, ...]:
        """See NodesProvider.nodes."""

    @property
    def binaries(self) -> Path:
        """The tool chain's folder."""
        return self._named_binaries if self._named_binaries != Path() else toolchain.ensure().binaries

    def pulls_from(self) -> tuple[str, Sequence[Mapping[str, str]]]:
        """The registry (HOST/PATH) from which pods with volumes pull, and their imagePullSecrets; empty: by the names
        that images were built with."""
        return "", ()

    def reach(self, service: ServicePort) -> tuple[str, int]:
        """See Provider.reach."""
        return self._forwards.address(service)

    def way_of_a_person(self, service: ServicePort) -> WayOfAPerson:
        """See Provider.way_of_a_person."""
        where = f"kubectl --kubeconfig {self.kubeconfig()} -n {service.namespace}"
        command = f"{where} port-forward service/{service.name} {service.port}:{service.port}"
        return WayOfAPerson(HOST, service.port, command)

    @contextmanager
    def volumes(self) -> Iterator[PodVolumes]:
        """See Provider.volumes."""
        [image] = [one for one in image_lock.read_lock(image_lock.lock_file()) if one.name == IMAGE_OF_VOLUMES]
        registry, secrets = self.pulls_from()
        guests = {node.agent: node.guest for node in self.nodes() if node.guest}
        used = PodVolumes(self._kubectl, moved(image.reference, registry), self.work(), secrets, guests)
        try:
            yield used
        finally:
            used.end()

    @functools.cached_property
    def _forwards(self) -> Forwards:
        return Forwards(self._kubectl)

    @property
    def _kubectl(self) -> list[str]:
        return [str(self.binaries / "kubectl"), "--kubeconfig", str(self.kubeconfig())]


def values_of_built_images() -> dict[str, Any]:
    """What the chart is told where images that were built here run, on Nodes with the labels of agents."""
    built = yaml.safe_load(OF_BUILT_IMAGES.read_text(encoding="utf-8"))
    return {
        "platform": {"nodeSelector": {"robotkube.io/role": "platform"}},
        "gate": {"localBuilds": True},
        "database": {key: built["database"][key] for key in ("kind", "arguments")},
        "forge": {"staticRootPath": built["forge"]["staticRootPath"]},
    }
