"""Where a bundle goes: a registry and a path of it, as people write them."""

from __future__ import annotations

from dataclasses import dataclass

from robotkube.errors import InputError
from robotkube.foundation.documents.core.patterns import REGISTRY_PATH
from robotkube.registry.bundles.core.contents import BundleItem


@dataclass(frozen=True)
class RegistryPlace:
    """`host` with a port where it has one, and the `path` below which everything goes."""

    host: str
    path: str

    def __str__(self) -> str:
        return f"{self.host}/{self.path}"

    def repository(self, item: BundleItem) -> str:
        """The repository of an item, without the host."""
        return f"{self.path}/{item.repository}"

    def reference(self, item: BundleItem) -> str:
        """An item by its digest."""
        return f"{self}/{item.repository}@{item.digest}"


def read_place(text: str) -> RegistryPlace:
    """The place that a person wrote; InputError says how to write one."""
    match = REGISTRY_PATH.fullmatch(text.removesuffix("/"))
    if match is None:
        raise InputError(f"--to {text}: write HOST/PATH in lower case, such as registry.example.com/robots/robotkube")
    return RegistryPlace(match["host"], match["path"])
