"""The command `robotkube image push DIR|ARCHIVE`: an image in its publisher's place of the forge, by its digest, with
its bill of materials; its reference is written into images.yaml of the catalogue's sources, where charts are packed
with it. The reference is that of the place from which nodes pull: the gate copies it there when a chart with it is
submitted.

A folder is built first. The same image again changes nothing. Ends with 0 when all is there, 2 when something is wrong
or may not be done, 3 when the forge does not answer.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from robotkube.cli.images.building import build_source, choosing_build, image_name, sources_of
from robotkube.cli.output import Table
from robotkube.cli.registry.reaching import reach
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.core.packing import CHART_FILE
from robotkube.registry.images.adapters.bills import attach_document
from robotkube.registry.images.adapters.own_images import DOCKERFILE, OwnImage, describe_image
from robotkube.registry.publication.adapters import submission_folders
from robotkube.registry.publication.core.submissions import OWN_IMAGES, STAGING, pushed_place

COLUMNS = ("image", "reference", "written")


def choosing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `push`."""
    parser.add_argument(
        "source",
        type=Path,
        metavar="DIR|ARCHIVE",
        help=f"folder with a {DOCKERFILE}, which is built, or an OCI layout archive of any builder",
    )
    parser.add_argument("--host", default="", help="the OCI registry as nodes name it (default: as other images)")
    choosing_build(parser)


def push(options: argparse.Namespace) -> Table:
    """Push, and write the reference; the one row says both."""
    registry = sources_of(options)
    reached = reach(options, registry)
    access = reached.needed()
    image = _image(options)
    repository = f"{pushed_place(STAGING, access.username)}/{image.name}"
    with OciRegistry(access.url, access.username, access.password) as oci_registry:
        oci_registry.push_image(repository, image.archive)
        attach_document(oci_registry, repository, image.digest, image.bill.read_bytes())
    reference = f"{options.host or reached.host()}/{OWN_IMAGES}/{image.name}@{image.digest}"
    written = submission_folders.write_image(registry, image.name, reference)
    _remind(options.source, image.name, registry)
    row = {"image": image.name, "reference": reference, "digest": image.digest, "written": str(written)}
    return Table("images", COLUMNS, [row])


def _image(options: argparse.Namespace) -> OwnImage:
    source: Path = options.source
    if source.is_dir():
        return build_source(options).image
    return describe_image(source, image_name(options.name or source.name.partition(".")[0]))


def _remind(source: Path, image: str, registry: Path) -> None:
    """Say on stderr where the chart in `source` has to name the image, as long as it does not."""
    if not (source / CHART_FILE).is_file():
        return
    chart = source.resolve()
    entry, names = submission_folders.image_names(chart.name, chart.parent, registry)
    if image not in names:
        places = f"`robotkube.io/images` in {source / CHART_FILE}, its templates, and spec.images in {entry}"
        print(f"robotkube: chart {chart.name} does not run image {image} yet; name it in {places}", file=sys.stderr)
