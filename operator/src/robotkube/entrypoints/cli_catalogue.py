"""`robotkube catalogue list`: what the manager can select, as it reads it."""

from __future__ import annotations

import argparse

from robotkube.entrypoints.cli_output import Table
from robotkube.entrypoints.cli_platform import Platform


def list_catalogue(options: argparse.Namespace) -> Table:
    """Applications and chart versions of the manager's catalogue."""
    return Table(
        "entries", ("kind", "name", "version", "state", "description"), Platform(options).page("/catalogue")["entries"]
    )
