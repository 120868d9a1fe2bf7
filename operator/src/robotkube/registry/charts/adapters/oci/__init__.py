"""An OCI registry over HTTP (distribution specification 1.1): charts and images go in and out by digest, evidence is
attached to them."""

from robotkube.registry.charts.adapters.oci.image_layouts import (
    ArchivedBlob,
    read_archive,
    read_image_manifest,
    read_layout,
)
from robotkube.registry.charts.adapters.oci.oci_registry import OciRegistry

__all__ = ["ArchivedBlob", "OciRegistry", "read_archive", "read_image_manifest", "read_layout"]
