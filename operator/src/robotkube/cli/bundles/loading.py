"""The command `robotkube bundle load FILE`: a bundle's images are brought to where containers start, without a
registry. They are known there as the bundle's charts name them, so no value has to move them.

Ends with 0 when they are there, 2 when a program or folder is missing, 3 when the program fails.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from robotkube.cli.bundles.reading import choosing, opened
from robotkube.cli.output import Table
from robotkube.registry.bundles.adapters.loading import load_containerd, load_k3s, load_kind
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


def load_bundle(options: argparse.Namespace) -> Table:
    """Load the images."""
    bundle = opened(options)
    if options.kind:
        place = load_kind(bundle, options.kind)
    elif options.k3s:
        place = load_k3s(bundle, options.k3s)
    else:
        place = load_containerd(bundle, options.containerd)
    references = bundle.contents.references()
    rows = [
        {"image": item.name, "reference": references[item.name], "where": place} for item in bundle.contents.of(IMAGE)
    ]
    return Table("loaded", COLUMNS, rows)
