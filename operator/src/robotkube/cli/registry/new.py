"""The command `robotkube registry new NAME`: a chart and its catalogue entries to start from."""

from __future__ import annotations

import argparse
from pathlib import Path

from robotkube.cli.output import Table
from robotkube.errors import InputError
from robotkube.foundation.documents.core.patterns import CAPABILITY, NEW_CHART_NAME
from robotkube.registry.catalogue.adapters.skeletons import new_application


def naming(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("name", metavar="NAME", help="of the application and its chart, such as text-relay")
    parser.add_argument("--provides", metavar="CAPABILITY", help="what the chart is good for (default: <NAME>/relay)")
    parser.add_argument("--charts", type=Path, default=Path("charts/apps"), help="folder of the charts")
    parser.add_argument("--registry", type=Path, default=Path("registry"), help="folder of the catalogue's sources")
    parser.add_argument("--dry-run", action="store_true", help="only say which files would be written")


def new(options: argparse.Namespace) -> Table:
    """Write the chart and its entries; the table lists the files."""
    provides = options.provides or f"{options.name}/relay"
    if not NEW_CHART_NAME.fullmatch(options.name):
        raise InputError(f"NAME {options.name!r}: use 2 to 30 lower-case letters, digits and single hyphens")
    if not CAPABILITY.fullmatch(provides):
        raise InputError(f"--provides {provides!r}: use words of lower-case letters and hyphens, separated by slashes")
    written = new_application(options.name, provides, options.charts, options.registry, options.dry_run)
    return Table("files", ("file",), [{"file": str(path)} for path in written])
