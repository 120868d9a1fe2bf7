"""Admission in the embedded cluster: policies from files, which the provider writes on the host and no request to the
API server can see, change or delete.

    <cluster>/admission/settings.json   agents' namespaces and the platform's images, as the provider knows them
    <cluster>/admission/keys/*.pem      public keys whose signatures count
    <cluster>/admission/listing.json    the last list of the catalogue, for a process that starts again
    <cluster>/admission/...             what the API server reads (`PolicyFiles`)

Before the API server starts, the policies list the images of the platform. A process of the host, `admission`, follows
the catalogue from then on (`ci.cluster.embedded.admission.controller`).
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ci import evidence
from ci.cluster.embedded.first_objects import SUITE_NAMESPACES
from ci.cluster.embedded.host import followers
from ci.cluster.embedded.host.processes import Launcher, Process
from ci.cluster.embedded.host.records import ClusterFolders, write_atomically
from ci.cluster_contract.topology import Topology
from ci.errors import InputError
from ci.images.image_lock import Image
from robotkube.errors import RobotKubeError
from robotkube.registry.admission.adapters.listing_file import ListingFile
from robotkube.registry.admission.adapters.policy_files import PolicyFiles
from robotkube.registry.admission.core.allowed import Allowed, digests_of
from robotkube.registry.admission.core.domain import Domain
from robotkube.registry.admission.core.policies import for_files

if TYPE_CHECKING:
    from robotkube.registry.admission.loops.policy_reconciler import CatalogueListing, PolicyReconciler, Surroundings

VARIABLE = "ROBOTKUBE_ADMISSION"
FILES, OFF = "files", "off"
CHOICES = (FILES, OFF)
PROCESS = "admission"
MODULE = "ci.cluster.embedded.admission.controller"
CHARTS = "oci://forge.robotkube.svc.cluster.local:3000/verified"  # where charts/robotkube has them
PLATFORM_ROLE = "platform"  # of machines that are no agents
SETTINGS_KEYS = {"agents", "platform"}


def choice(given: str = "") -> str:
    """Return whether admission is enforced: what is `given`, else the environment's ROBOTKUBE_ADMISSION, else from
    files."""
    word = given or os.environ.get(VARIABLE, "") or FILES
    if word not in CHOICES:
        raise InputError(f"{VARIABLE}: {word!r} must be one of {', '.join(CHOICES)}")
    return word


def folder(folders: ClusterFolders) -> Path:
    """The folder of all files of admission."""
    return folders.base / "admission"


def policy_files(folders: ClusterFolders) -> PolicyFiles:
    """What the API server reads."""
    return PolicyFiles(folder(folders))


def prepare(folders: ClusterFolders, topology: Topology, images: Sequence[Image]) -> Mapping[str, str]:
    """Write settings, keys and the first policies; returns the API server's options. Images of services are not the
    platform's: they run when the catalogue lists them. InputError names an image of the lock without a digest."""
    _write_settings(folders, agents_of(topology), [image.reference for image in images if not image.ground])
    key = evidence.signing_key()
    keys = folder(folders) / "keys"
    keys.mkdir(parents=True, exist_ok=True)
    write_atomically(keys / f"{key.key_id}.pem", key.public_key)
    files = policy_files(folders)
    try:
        around = surroundings(folders)
        files.write(for_files(around.domain, Allowed(platform=around.platform)))
    except RobotKubeError as error:
        raise InputError(f"admission: {error}") from error
    return files.options


def rules(folders: ClusterFolders, topology: Topology) -> list[str]:
    """The policies without a list, as text."""
    return [json.dumps(for_files(domain_of(agents_of(topology), folders), Allowed()), sort_keys=True)]


def start_controller(launcher: Launcher) -> Process:
    """The process that follows the catalogue, started again when it ends: without it nothing that is published runs."""
    return followers.start(launcher, PROCESS, MODULE)


def add(folders: ClusterFolders, agents: Sequence[str] = (), images: Sequence[Image] = ()) -> None:
    """Let further agents have namespaces, and further images run on the platform; nothing where admission is off. The
    process `admission` writes the policies of it."""
    if not _settings_file(folders).is_file():
        return
    known = _read_settings(folders)
    references = [image.reference for image in images]
    _write_settings(folders, [*known["agents"], *agents], [*known["platform"], *references])


def policy_reconciler(folders: ClusterFolders, listing: CatalogueListing) -> PolicyReconciler:
    """What writes the policies of a cluster as its catalogue lists."""
    from robotkube.registry.admission.loops.policy_reconciler import PolicyReconciler

    memory = ListingFile(folder(folders) / "listing.json")
    return PolicyReconciler(listing, policy_files(folders), lambda: surroundings(folders), memory)


def surroundings(folders: ClusterFolders) -> Surroundings:
    """What the settings say, for the policies."""
    from robotkube.registry.admission.loops.policy_reconciler import Surroundings

    known = _read_settings(folders)
    return Surroundings(domain_of(known["agents"], folders), digests_of(known["platform"]))


def agents_of(topology: Topology) -> list[str]:
    """The agents of a topology; each has a namespace of its name."""
    return sorted({node.agent for node in topology.nodes if node.role != PLATFORM_ROLE})


def domain_of(agents: Sequence[str], folders: ClusterFolders) -> Domain:
    """The domain of a cluster that is all ours, with these agents."""
    tests = tuple(f"robotkube-suite-{number}" for number in range(SUITE_NAMESPACES))
    return Domain(tuple(sorted(set(agents))), tests, CHARTS, elsewhere=True, volumes=str(folders.volumes))


def _settings_file(folders: ClusterFolders) -> Path:
    return folder(folders) / "settings.json"


def _read_settings(folders: ClusterFolders) -> dict[str, list[str]]:
    path = _settings_file(folders)
    try:
        document: Any = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}; start the cluster anew") from error
    if not isinstance(document, dict) or set(document) != SETTINGS_KEYS:
        raise InputError(f"{path}: must have {', '.join(sorted(SETTINGS_KEYS))}; start the cluster anew")
    return document


def _write_settings(folders: ClusterFolders, agents: Sequence[str], references: Sequence[str]) -> None:
    folder(folders).mkdir(parents=True, exist_ok=True)
    document = {"agents": sorted(set(agents)), "platform": sorted(set(references))}
    write_atomically(_settings_file(folders), json.dumps(document, indent=1))
