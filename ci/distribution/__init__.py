"""An OCI registry as others run it, distribution with tokens: what the slower proofs push bundles to. Only they build
it."""

from __future__ import annotations

from pathlib import Path

from ci.toolchain.kept import Kept
from ci.toolchain.programs import VERSION, Program, Stamps, Versions

FOLDER = Path(__file__).resolve().parent
MODULE = "github.com/distribution/distribution/v3"


def stamps(versions: Versions) -> Stamps:
    """The version that it says."""
    return {f"{MODULE}/version.version": versions[MODULE]}


PROGRAMS = (Program("registry", MODULE, ".", {"registry": VERSION}, folder=FOLDER, stamps=stamps),)


def ensure() -> Path:
    """The folder of the program, built if the cache lacks it; raises SetUpError when it cannot be built."""
    return Kept("distribution", FOLDER, MODULE, PROGRAMS).ensure()
