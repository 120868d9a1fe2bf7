"""The command `robotkube registry new NAME`: charts and their catalogue entries to start from."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from robotkube.cli.output import Table
from robotkube.errors import InputError
from robotkube.foundation.documents.core.patterns import CAPABILITY, NEW_CHART_NAME
from robotkube.registry.catalogue.adapters.skeletons import new_application, new_chain
from robotkube.registry.catalogue.core.links.chains import SERVICES_MAX, service_problems


def naming(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("name", metavar="NAME", help="of the application and its chart, such as text-relay")
    parser.add_argument(
        "--services",
        metavar="NAME,...",
        help=f"one chart <NAME>-<service> for each of up to {SERVICES_MAX}, in a chain (default: one chart <NAME>)",
    )
    parser.add_argument("--provides", metavar="CAPABILITY", help="what it is good for (default: <NAME>/relay)")
    parser.add_argument("--charts", type=Path, default=Path("charts/apps"), help="folder of the charts")
    parser.add_argument("--registry", type=Path, default=Path("registry"), help="folder of the catalogue's sources")
    parser.add_argument("--dry-run", action="store_true", help="only say which files would be written")


def new(options: argparse.Namespace) -> Table:
    """Write the charts and their entries; the table lists the files."""
    services = None if options.services is None else [word.strip() for word in options.services.split(",")]
    provides = options.provides or f"{options.name}/relay"
    _check(options.name, options.provides, services)
    folders = (options.charts, options.registry, options.dry_run)
    if services is None:
        written = new_application(options.name, provides, *folders)
    else:
        written = new_chain(options.name, services, provides, *folders)
    return Table("files", ("file",), [{"file": str(path)} for path in written])


def _check(name: str, provides: str | None, services: Sequence[str] | None) -> None:
    """InputError names everything that is wrong with the names."""
    problems = []
    if not NEW_CHART_NAME.fullmatch(name):
        problems.append(f"NAME {name!r}: use 2 to 30 lower-case letters, digits and single hyphens")
    elif services is not None:
        problems += [f"--services: {problem}" for problem in service_problems(name, services)]
    if provides is not None and not CAPABILITY.fullmatch(provides):
        problems.append(f"--provides {provides!r}: use words of lower-case letters and hyphens, separated by slashes")
    if problems:
        raise InputError("; ".join(problems))
