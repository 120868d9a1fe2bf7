"""The commands `robotkube bundle show` and `robotkube bundle manifests`: what a bundle holds, from the file alone."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from robotkube.cli.output import Table
from robotkube.errors import InputError
from robotkube.registry.bundles.adapters.layouts import Bundle, read_bundle
from robotkube.registry.bundles.core.contents import CHART, KINDS, MANIFESTS, PLATFORM_CHART
from robotkube.registry.bundles.core.places import read_place

FOLDER = Path("build/bundle")
COLUMNS = ("kind", "name", "version", "digest", "size", "attached")
MANIFESTS_BYTES_MAX = 64 << 20
EVIDENCE = "evidence: "
KILOBYTE, MEGABYTE = 1e3, 1e6


def choosing(parser: argparse.ArgumentParser) -> None:
    """Add the argument of every command about a bundle."""
    parser.add_argument(
        "file", type=Path, nargs="?", metavar="FILE", help=f"the bundle (default: the newest in {FOLDER})"
    )


def showing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `show`."""
    choosing(parser)
    parser.add_argument("--check", action="store_true", help="compute every digest anew, which reads all of the file")


def printing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `manifests`."""
    choosing(parser)
    parser.add_argument("--name", default="argocd", help="which (default: argocd)")
    parser.add_argument(
        "--registry", default="", metavar="HOST/PATH", help="where the images were pushed (default: as they were built)"
    )


def opened(options: argparse.Namespace) -> Bundle:
    """The bundle that is meant; InputError when there is none."""
    if options.file is not None:
        return read_bundle(options.file)
    files = sorted(FOLDER.glob("robotkube-*.tar"), key=lambda path: path.stat().st_mtime)
    if not files:
        raise InputError(f"{FOLDER}: no bundle; name its file, or make one: make bundle")
    return read_bundle(files[-1])


def show_bundle(options: argparse.Namespace) -> Table:
    """Everything in it, with digests."""
    bundle = opened(options)
    if options.check:
        bundle.check()
        print(f"robotkube: {len(bundle.blobs)} blobs have the bytes of their digests", file=sys.stderr)
    items = [item for kind in KINDS for item in bundle.contents.of(kind)]
    rows = [
        {
            "kind": item.kind,
            "name": item.name,
            "version": item.version,
            "digest": item.digest,
            "size": _readable(item.size),
            "bytes": item.size,
            "attached": [one.title.removeprefix(EVIDENCE) for one in item.attached],
            "attachments": {one.title: one.digest for one in item.attached},
        }
        for item in items
    ]
    without = [
        f"{item.name} {item.version}"
        for item in bundle.contents.of(CHART)
        if not item.attached and item.name != PLATFORM_CHART
    ]
    if without:
        print(f"robotkube: without evidence: {', '.join(without)}", file=sys.stderr)
    return Table("contents", COLUMNS, rows)


def _readable(size: int) -> str:
    return f"{size / MEGABYTE:.1f} MB" if size >= MEGABYTE else f"{size / KILOBYTE:.0f} kB"


def show_manifests(options: argparse.Namespace) -> Table:
    """Objects to apply, with their images as they are known where they were brought."""
    bundle = opened(options)
    named = [item for item in bundle.contents.of(MANIFESTS) if item.name == options.name]
    if not named:
        there = ", ".join(item.name for item in bundle.contents.of(MANIFESTS))
        raise InputError(f"{bundle.path}: no manifests {options.name}; there are: {there or 'none'}")
    _, *layers = bundle.parts(named[0].digest)
    if len(layers) != 1:
        raise InputError(f"{bundle.path}: manifests {options.name} have {len(layers)} layers instead of one")
    text = bundle.read(layers[0], MANIFESTS_BYTES_MAX).decode()
    if options.registry:
        place = read_place(options.registry, "--registry")
        text = text.replace(f"{bundle.contents.prefix}/", f"{place}/")
    return Table("manifests", (), [{"text": text}], text=text)
