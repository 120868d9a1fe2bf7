"""Destinations of bundles: a registry and a path of it, as people write them."""

from __future__ import annotations

import re
from dataclasses import dataclass

from robotkube.errors import InputError
from robotkube.foundation.documents.core.patterns import REGISTRY_PATH
from robotkube.registry.bundles.core.contents import BundleItem

PART = r"[a-z0-9]+(?:(?:\.|_{1,2}|-+)[a-z0-9]+)*"
REPOSITORY = re.compile(rf"{PART}(?:/{PART})*", re.ASCII)  # as registries take them (OCI distribution specification)


@dataclass(frozen=True)
class RegistryPlace:
    """A place in a registry: `host` with a port where it has one, and the `path` below which everything goes."""

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


def read_place(text: str, option: str = "--to") -> RegistryPlace:
    """The place that a person wrote for an `option`; InputError says how to write one."""
    match = REGISTRY_PATH.fullmatch(text.removesuffix("/"))
    if match is None or not REPOSITORY.fullmatch(match["path"]):
        raise InputError(
            f"{option} {text}: write HOST/PATH in lower case and without oci:// or https://, such as "
            "registry.example.com/robots/robotkube"
        )
    host = match["host"]
    if host != "localhost" and not set(".:") & set(host):
        raise InputError(
            f"{option} {text}: {host} has neither a dot nor a port, so container runtimes take it for a path of Docker "
            f"Hub: write the registry's whole name, such as {host}.example.com, or its port"
        )
    return RegistryPlace(host, match["path"])
