"""The suites that need no test namespace, on their libraries: as the suite-runner and `robotkube registry try` run
them."""

from __future__ import annotations

import tempfile
from pathlib import Path

from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.adapters.json_schema import violations
from robotkube.registry.charts.ports import ImageRegistry
from robotkube.registry.suites.adapters.kept_layers import KeptLayers
from robotkube.registry.suites.loops.images import ImagesSuite
from robotkube.registry.suites.loops.static import StaticSuite

LAYERS_FOLDER = "suite-layers"  # shared by the processes of all runs


def static_suite() -> StaticSuite:
    """The suite `static`."""
    return StaticSuite(violations, Jinja2Templates().render)


def images_suite(oci_registry: ImageRegistry, host: str) -> ImagesSuite:
    """The suite `images` on the platform's OCI registry; `host` is that registry as references name it. What it read of
    layers is kept in the machine's folder for temporary files."""
    kept = KeptLayers(Path(tempfile.gettempdir()) / LAYERS_FOLDER)
    return ImagesSuite(oci_registry, kept, host, Jinja2Templates().render)
