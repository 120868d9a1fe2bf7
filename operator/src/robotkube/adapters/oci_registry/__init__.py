"""An OCI registry over HTTP (distribution specification 1.1): charts and images go in and out by digest, evidence is
attached to them."""

from robotkube.adapters.oci_registry.layouts import ArchivedBlob, read_layout
from robotkube.adapters.oci_registry.registry import Registry

__all__ = ["ArchivedBlob", "Registry", "read_layout"]
