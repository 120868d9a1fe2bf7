"""The command `robotkube bundle load FILE`: a bundle's images are brought to where containers start, without a
registry. They are known there as the bundle's charts name them, so no value has to move them.

Ends with 0 when they are there, 2 when a program or folder is missing, 3 when the program fails.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from robotkube.cli.bundles.reading import choosing, opened
from robotkube.cli.output import Table
from robotkube.errors import InputError
from robotkube.registry.bundles.adapters.layouts import Bundle
from robotkube.registry.bundles.adapters.loading import load_containerd, load_k3s, load_kind, others_of_k3s
from robotkube.registry.bundles.core.contents import IMAGE

ADDRESS = "/run/containerd/containerd.sock"
COLUMNS = ("image", "reference", "where")


def loading(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `load`."""
    choosing(parser)
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--kind", metavar="NAME", help="every node of this kind cluster")
    where.add_argument("--k3s", type=Path, metavar="DIR", help="the folder from which k3s imports, on each node")
    where.add_argument(
        "--containerd", nargs="?", const=ADDRESS, metavar="SOCKET", help=f"the containerd here (default: {ADDRESS})"
    )
    parser.add_argument(
        "--replace", action="store_true", help="with --k3s: remove archives that earlier loads put into that folder"
    )


def load_bundle(options: argparse.Namespace) -> Table:
    """Load the images."""
    if options.replace and not options.k3s:
        raise InputError("--replace: removes files of the folder that --k3s names, and that is not given")
    bundle = opened(options)
    if options.kind:
        place = load_kind(bundle, options.kind)
    elif options.k3s:
        place = _into_folder(bundle, options.k3s, options.replace)
    else:
        place = load_containerd(bundle, options.containerd)
    references = bundle.contents.references()
    rows = [
        {"image": item.name, "reference": references[item.name], "where": place} for item in bundle.contents.of(IMAGE)
    ]
    return Table("loaded", COLUMNS, rows)


def _into_folder(bundle: Bundle, folder: Path, replace: bool) -> str:
    """The archive in the folder of k3s; what earlier loads left there is named, or removed."""
    try:
        archive = load_k3s(bundle, folder)
    except OSError as error:
        raise InputError(f"--k3s {folder}: cannot be written to: {error.strerror}; on a node it is root's") from error
    for other in others_of_k3s(archive):
        if replace:
            other.unlink(missing_ok=True)
            print(f"robotkube: {other} is removed; what k3s imported of it stays", file=sys.stderr)
        else:
            says = "k3s imports it at each start as well; --replace removes it, when nothing of it is needed any more"
            print(f"robotkube: {other} is of an earlier load: {says}", file=sys.stderr)
    return str(archive)
