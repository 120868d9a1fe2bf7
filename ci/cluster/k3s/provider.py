"""The provider `k3s`: what `existing` does, with what is known of a k3s."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ci.cluster.existing.nodes import Ask, GivenCluster
from ci.cluster.existing.provider import Existing
from ci.cluster.existing.registry import place_of
from ci.cluster.k3s import archives, nodes, registries
from ci.cluster.k3s.nodes import K3sNode
from ci.cluster.k3s.values import STORAGE, chart_values
from ci.errors import InputError
from ci.images.image_lock import Image
from ci.steps import Steps

KUBECONFIG = Path("/etc/rancher/k3s/k3s.yaml")


class K3s(Existing):
    """One k3s that is there. Its own kubeconfig is taken where nobody names one. Without a registry images go into the
    folder from which k3s imports, if all Nodes are this machine's."""

    kind = "k3s"

    def __init__(self, given: GivenCluster, ask: Ask | None = None, binaries: Path = Path()) -> None:
        super().__init__(replace(given, kubeconfig=kubeconfig_of(given)), ask, binaries)

    @property
    def registries_file(self) -> Path:
        """The text of registries.yaml for each Node, where images are pulled from a registry."""
        return self.work() / "registries.yaml"

    @property
    def authority_file(self) -> Path:
        """The file of that registry's authority, for each Node, where it is none of the usual ones."""
        return self.work() / Path(registries.AUTHORITY).name

    def take(self) -> tuple[str, ...]:
        """See Existing.take."""
        written = super().take()
        self._write_registries()
        return written

    def recognise(self) -> None:
        """See Existing.recognise: every Node is k3s's, and there is a class for volumes."""
        others = [f"{node.name} ({node.version or 'no version'})" for node in self._read() if not node.is_k3s]
        if others:
            raise InputError(
                f"context {self.name}: kubelets of k3s have {nodes.MARK} in their version, and these have not: "
                f"{', '.join(others)}; CLUSTER=existing takes Nodes of any cluster"
            )
        classes = self._nodes.storage_classes()
        stated = self._with_given({}).get("storage")
        if STORAGE not in classes and not (isinstance(stated, dict) and stated.get("className")):
            there = ", ".join(sorted(classes)) or "none"
            raise InputError(
                f"context {self.name}: StorageClass {STORAGE} is not there, which k3s brings unless it is started with "
                f"--disable=local-storage; there is: {there}. Name one by VALUES: storage: {{className: ...}}"
            )

    def of_cluster(self) -> Mapping[str, Any]:
        """See Existing.of_cluster."""
        return chart_values(self._read(), self._nodes.api_servers(), self._nodes.storage_classes())

    def lacking_images(self) -> str:
        """See Existing.lacking_images."""
        if not self._given.registry:
            return "what publishers push to the forge is not pulled by Nodes: images are imported"
        return (
            f"application charts name images as they were built: Nodes find these when {registries.FILE} of each says "
            f"what {self.registries_file} does (docs/how-to/run-on-k3s.md), and what publishers push to the forge is "
            "not pulled"
        )

    def images_to_bring(self, wanted: Sequence[Image]) -> list[str]:
        """See Existing.images_to_bring."""
        if self._given.registry:
            return []
        others = [node.name for node in self._read() if not node.is_on(nodes.this_boot())]
        if others:
            raise InputError(
                f"REGISTRY=HOST/PATH is needed: {', '.join(others)} are other machines than this one, and without a "
                "registry images are put into a folder of this one, from which k3s imports"
            )
        file = archives.archive(wanted)
        return [] if file.exists() else [f"file {file}: all images, which k3s imports"]

    def bring_images(self, wanted: Sequence[Image]) -> None:
        """See Existing.bring_images."""
        with Steps(1).step("images of k3s") as step:
            if self._given.registry:
                self._write_registries()
                step.note = f"from {self._place()}; {self.registries_file} is for each Node's {registries.FILE}"
            else:
                archives.bring(wanted, self.work() / "images", self._read)
                step.note = f"imported from {archives.named_folder()}"

    def brought(self) -> tuple[Path, ...]:
        """See Existing.brought: those of this machine's Nodes."""
        return archives.archives() if self._all_here() else ()

    def down(self) -> tuple[str, ...]:
        """See NodesProvider.down."""
        removed = super().down()
        for file in (self.registries_file, self.authority_file):
            file.unlink(missing_ok=True)
        return removed

    def kept(self) -> tuple[str, ...]:
        """See NodesProvider.kept."""
        hidden = archives.hidden() if self._all_here() else ""
        images = f"images that Nodes have pulled or imported, and {registries.FILE} of each"
        return (*super().kept(), images, *filter(None, [hidden]))

    def _write_registries(self) -> None:
        """Write what Nodes need to pull from the registry, if there is one."""
        if not self._given.registry:
            return
        self.work().mkdir(parents=True, exist_ok=True)
        authority = self._given.authority
        text = registries.registries(place_of(self._given.registry), authority is not None)
        self.registries_file.write_text(text, encoding="utf-8")
        if authority is not None:
            shutil.copyfile(authority, self.authority_file)

    def _read(self) -> list[K3sNode]:
        return [nodes.read(item) for item in self._nodes.objects()]

    def _all_here(self) -> bool:
        """Return whether this machine is that of every Node."""
        return all(node.is_on(nodes.this_boot()) for node in self._read())


def kubeconfig_of(given: GivenCluster) -> str:
    """The kubeconfig that somebody named, or k3s's own; InputError where that cannot be read."""
    if given.kubeconfig or os.environ.get("KUBECONFIG"):
        return given.kubeconfig
    try:
        with KUBECONFIG.open("rb"):
            return str(KUBECONFIG)
    except FileNotFoundError as error:
        raise InputError(
            f"{KUBECONFIG}: is not there, so no server of k3s runs on this machine; name the kubeconfig of the one "
            "that is meant: KUBECONFIG=FILE"
        ) from error
    except OSError as error:
        raise InputError(
            f"{KUBECONFIG}: cannot be read ({error.strerror}); run this as root, or copy it to a file of your own "
            "(sudo cat) and name that: KUBECONFIG=FILE"
        ) from error
