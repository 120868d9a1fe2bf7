"""Ways into a cluster of which this machine surely reaches the API server alone: forwards to Services, files by pods,
and what the platform's chart is told of images that were built here."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from ci.cluster import images
from ci.cluster.existing.forwards import HOST, Forwards
from ci.cluster.existing.pod_volumes import PodVolumes
from ci.cluster.provider import ServicePort, WayOfAPerson
from ci.folders import PROJECT
from ci.installation import moved

OF_BUILT_IMAGES = PROJECT / "charts" / "robotkube" / "values-embedded.yaml"
IMAGE_OF_VOLUMES = "ros"  # those of agents' applications stand on it, so their Nodes have its layers


@dataclass
class ApiServerWays:
    """The ways of one cluster, as long as this process runs. Copies of files are put below `work`; pods with volumes
    pull from `registry`, where there is one, by `pull_secrets`."""

    binaries: Path
    kubeconfig: Path
    work: Path
    registry: str = ""
    pull_secrets: Sequence[Mapping[str, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._kubectl = [str(self.binaries / "kubectl"), "--kubeconfig", str(self.kubeconfig)]
        self._forwards = Forwards(self._kubectl)

    def reach(self, service: ServicePort) -> tuple[str, int]:
        """See Provider.reach."""
        return self._forwards.address(service)

    def of_a_person(self, service: ServicePort) -> WayOfAPerson:
        """See Provider.way_of_a_person."""
        where = f"kubectl --kubeconfig {self.kubeconfig} -n {service.namespace}"
        command = f"{where} port-forward service/{service.name} {service.port}:{service.port}"
        return WayOfAPerson(HOST, service.port, command)

    @contextmanager
    def volumes(self) -> Iterator[PodVolumes]:
        """See Provider.volumes."""
        [image] = [one for one in images.read_lock(images.lock_file()) if one.name == IMAGE_OF_VOLUMES]
        used = PodVolumes(self._kubectl, moved(image.reference, self.registry), self.work, self.pull_secrets)
        try:
            yield used
        finally:
            used.end()


def values_of_built_images() -> dict[str, Any]:
    """What the chart is told where images that were built here run, on Nodes with the labels of agents."""
    built = yaml.safe_load(OF_BUILT_IMAGES.read_text(encoding="utf-8"))
    return {
        "platform": {"nodeSelector": {"robotkube.io/role": "platform"}},
        "gate": {"localBuilds": True},
        "database": {key: built["database"][key] for key in ("kind", "arguments")},
        "forge": {"staticRootPath": built["forge"]["staticRootPath"]},
    }
