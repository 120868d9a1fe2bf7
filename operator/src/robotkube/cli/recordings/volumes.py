"""The volume claims with segments that are within reach of the command line.

A volume of a recording is `<node>/<claim>`. Its folder is what `--segments` says; else the folder of the bound
PersistentVolume (`local` or `hostPath`), where this machine has it: on the embedded cluster, and on the node itself.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from robotkube.errors import InputError

HOSTNAME = "kubernetes.io/hostname"


def add_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option of every command that reads segments."""
    parser.add_argument(
        "--segments",
        action="append",
        default=[],
        metavar="VOLUME=FOLDER",
        help="where a volume (<node>/<claim>) is within reach; once per volume (default: its folder on this machine)",
    )


def volume_place(text: str) -> tuple[str, Path]:
    """The volume and the folder in `VOLUME=FOLDER` of an option."""
    volume, separator, folder = text.partition("=")
    if not separator or "/" not in volume or not Path(folder).is_dir():
        raise InputError(f"--segments {text!r} must be <node>/<claim>=<existing folder>, as cloud-0/recordings=...")
    return volume, Path(folder)


def folders_here(volumes: Sequence[Mapping[str, Any]]) -> dict[str, Path]:
    """The folders of volumes `<node>/<claim>`, by the cluster's PersistentVolumes.

    Volume claims of one name in two namespaces of a node cannot be distinguished: neither is used.
    """
    places = [place for volume in volumes for place in _places(volume["spec"])]
    times = Counter(name for name, _ in places)
    return {name: folder for name, folder in places if times[name] == 1 and folder.is_dir()}


def _places(spec: Mapping[str, Any]) -> Iterator[tuple[str, Path]]:
    folder = (spec.get("local") or spec.get("hostPath") or {}).get("path")
    claim = (spec.get("claimRef") or {}).get("name")
    if folder and claim:
        yield from ((f"{node}/{claim}", Path(folder)) for node in _nodes(spec))


def _nodes(spec: Mapping[str, Any]) -> Iterator[str]:
    required = (spec.get("nodeAffinity") or {}).get("required") or {}
    for term in required.get("nodeSelectorTerms") or []:
        for expression in term.get("matchExpressions") or []:
            if expression["key"] == HOSTNAME and expression["operator"] == "In":
                yield from expression["values"]
