"""What a Node says of itself where it is k3s's. Pure, but for which machine this one is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

MARK = "+k3s"  # in the version of each of its kubelets: v1.34.1+k3s1
BOOT = Path("/proc/sys/kernel/random/boot_id")  # what a kubelet reads; containers of a machine have it in common
# A kubelet lists so many of its images at most, unless it is told otherwise. What is not in a longer list may be there.
LISTED_IMAGES_MAX = 50


@dataclass(frozen=True)
class K3sNode:
    """A Node: its kubelet's `version`, the `boot` of its machine, the ranges that its pods' addresses are of, and the
    names of the `images` that it has; None where it has so many that it does not list all."""

    name: str
    address: str
    version: str
    boot: str
    pod_ranges: tuple[str, ...] = ()
    images: frozenset[str] | None = frozenset()

    @property
    def is_k3s(self) -> bool:
        """Return whether it is k3s's."""
        return MARK in self.version

    def is_on(self, boot: str) -> bool:
        """Return whether it is on the machine that was booted so."""
        return self.boot == boot

    def lacking(self, references: Iterable[str]) -> list[str]:
        """Those of the images that it surely has not."""
        return [reference for reference in references if self.images is not None and reference not in self.images]


def read(item: Mapping[str, Any]) -> K3sNode:
    """A Node of the API server."""
    status, spec = item.get("status", {}), item.get("spec", {})
    info = status.get("nodeInfo", {})
    images = status.get("images") or ()
    addresses = {one["type"]: one["address"] for one in reversed(status.get("addresses") or ())}
    names = frozenset(name for image in images for name in image.get("names") or ())
    return K3sNode(
        item["metadata"]["name"],
        addresses.get("InternalIP", ""),
        info.get("kubeletVersion", ""),
        info.get("bootID", ""),
        tuple(spec.get("podCIDRs") or ()),
        names if len(images) < LISTED_IMAGES_MAX else None,
    )


def this_boot() -> str:
    """The boot of this machine, as a kubelet on it says it."""
    return BOOT.read_text(encoding="ascii").strip()
