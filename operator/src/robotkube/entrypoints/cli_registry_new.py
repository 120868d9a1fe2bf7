"""`robotkube registry new NAME`: a chart and its catalogue entries to start from."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from robotkube.adapters.skeleton_files import new_application
from robotkube.domain.errors import InputError
from robotkube.entrypoints.cli_output import Table

CHART_NAME = re.compile(r"[a-z]([a-z0-9]|-(?=[a-z0-9])){0,28}[a-z0-9]", re.ASCII)
CAPABILITY = re.compile(r"[a-z0-9-]+(/[a-z0-9-]+)*", re.ASCII)


def naming(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("name", metavar="NAME", help="of the application and its chart, such as text-relay")
    parser.add_argument("--provides", metavar="CAPABILITY", help="what the chart is good for (default: <NAME>/relay)")
    parser.add_argument("--charts", type=Path, default=Path("charts/apps"), help="folder of the charts")
    parser.add_argument("--registry", type=Path, default=Path("registry"), help="folder of the catalogue's sources")
    parser.add_argument("--dry-run", action="store_true", help="only say which files would be written")


def new(options: argparse.Namespace) -> Table:
    """Write them; the table lists the files."""
    provides = options.provides or f"{options.name}/relay"
    if not CHART_NAME.fullmatch(options.name):
        raise InputError(f"NAME {options.name!r}: use 2 to 30 lower-case letters, digits and single hyphens")
    if not CAPABILITY.fullmatch(provides):
        raise InputError(f"--provides {provides!r}: use words of lower-case letters and hyphens, separated by slashes")
    written = new_application(options.name, provides, options.charts, options.registry, options.dry_run)
    return Table("files", ("file",), [{"file": str(path)} for path in written])
