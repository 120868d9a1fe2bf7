"""What enforced admission would strand of a cluster that runs: asked of the API server, changing nothing."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ci import evidence
from ci.cluster.api_server.client import Api
from ci.cluster.embedded.admission import admission_files
from ci.cluster.embedded.admission.catalogue_on_disk import CatalogueOnDisk
from ci.cluster.embedded.admission.controller import forge_folder
from ci.cluster.embedded.first_objects import ObjectReader
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.network.addresses import plan_of
from ci.cluster_contract.topology import Topology
from ci.errors import InputError, SetUpError
from ci.images.image_lock import Image
from robotkube.errors import RobotKubeError, UnavailableError
from robotkube.registry.admission.core.allowed import digests_of
from robotkube.registry.admission.core.listing import AllowedVersions
from robotkube.registry.admission.core.stranded import APPLICATIONS, KINDS, Stranded, counted, stranded
from robotkube.registry.admission.loops.policy_reconciler import CatalogueListing
from robotkube.registry.evidence.adapters.dsse import TrustedKeys


@dataclass(frozen=True)
class StrandedReport:
    """What would be stranded, and lines for people."""

    stranded: tuple[Stranded, ...]
    lines: tuple[str, ...]


def stranded_now(folders: ClusterFolders, topology: Topology, images: Sequence[Image]) -> StrandedReport:
    """Of the cluster that runs; SetUpError when there is none."""
    if not folders.kubeconfig.exists():
        raise SetUpError(f"cluster {folders.name} is not running: start it with make cluster")
    with Api(str(plan_of(folders.name).gateway), folders.pki) as api:
        return report(api, folders, topology, images)


def report(api: ObjectReader, folders: ClusterFolders, topology: Topology, images: Sequence[Image]) -> StrandedReport:
    """The same, as `api` sees the cluster."""
    with tempfile.TemporaryDirectory() as scratch:
        listed = _listing(api, Path(scratch))
    try:
        allowed = listed.with_platform(digests_of(image.reference for image in images))
    except RobotKubeError as error:
        raise InputError(f"images of the platform: {error}") from error
    result = stranded(_objects(api), admission_files.domain_of(admission_files.agents_of(topology), folders), allowed)
    return StrandedReport(result, (*listed.problems, *map(str, result), counted(result, allowed)))


def _listing(api: ObjectReader, scratch: Path) -> AllowedVersions:
    """The list as admission would have it now: without a catalogue, of nothing but the platform."""
    keys = scratch / "keys"
    keys.mkdir()
    (keys / "gate.pem").write_text(evidence.signing_key().public_key, encoding="utf-8")
    catalogue = CatalogueListing(CatalogueOnDisk(forge_folder(api), scratch / "clones"), TrustedKeys(keys))
    try:
        return catalogue.read() or AllowedVersions()
    except UnavailableError as error:
        return AllowedVersions(problems=(str(error),))


def _objects(api: ObjectReader) -> Iterator[dict[str, Any]]:
    """Items of lists, which do not say their kind."""
    for path, kind in KINDS.items():
        yield from ({**item, "kind": kind} for item in api.get(path)["items"])
    try:
        applications = api.get(APPLICATIONS)["items"]
    except SetUpError as error:
        if ": 404 " in f"{error} ":
            return  # Argo CD is not installed
        raise
    yield from ({**item, "kind": "Application"} for item in applications)
