"""oras, the program that copies bundles to registries: built by `make bundle`, which puts it beside the bundle, and by
the slower proofs."""

from __future__ import annotations

from pathlib import Path

from ci.toolchain.kept import Kept
from ci.toolchain.programs import Program, Stamps, Versions

FOLDER = Path(__file__).resolve().parent
MODULE = "oras.land/oras"


def stamps(versions: Versions) -> Stamps:
    """The version that it says, without the word for a build between versions."""
    version = f"{MODULE}/internal/version"
    return {f"{version}.Version": versions[MODULE].removeprefix("v"), f"{version}.BuildMetadata": ""}


PROGRAMS = (Program("oras", MODULE, f"{MODULE}/cmd/oras", {"oras": ("version",)}, folder=FOLDER, stamps=stamps),)


def ensure() -> Path:
    """The folder of the program, built if the cache lacks it; raises SetUpError when it cannot be built."""
    return Kept("oras", FOLDER, MODULE, PROGRAMS).ensure()
