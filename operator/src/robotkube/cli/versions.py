"""The command `robotkube version`: what this program is, and what it talks to."""

from __future__ import annotations

import argparse

from robotkube import VERSION
from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.errors import InputError, UnavailableError


def asking(parser: argparse.ArgumentParser) -> None:
    """Add the argument of `version`."""
    parser.add_argument("--client", action="store_true", help="only this program's, without asking a cluster")


def show_versions(options: argparse.Namespace) -> Table:
    """List the versions; what cannot be reached is said after the others."""
    versions = {"robotkube": VERSION}
    unreachable = ""
    try:
        versions |= {} if options.client else Platform(options).versions()
    except (InputError, UnavailableError) as error:
        unreachable = f"the platform's version is not known: {error}"
    rows = [{"program": name, "version": version} for name, version in versions.items()]
    return Table("versions", ("program", "version"), rows, unreachable=unreachable)
