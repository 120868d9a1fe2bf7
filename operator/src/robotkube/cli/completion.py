"""The command `robotkube completion`: a script for a shell, by which it completes commands and options."""

from __future__ import annotations

import argparse

import shtab

from robotkube.cli.output import Table


def naming(parser: argparse.ArgumentParser) -> None:
    """Add the argument of `completion`."""
    parser.add_argument("shell", choices=("bash", "fish", "zsh"), help="which shell")


def complete(options: argparse.Namespace) -> Table:
    """Show the shell's script, of the whole command line's grammar."""
    script = shtab.complete(options.grammar, options.shell)
    return Table("completion", (), [{"shell": options.shell, "script": script}], single=True, text=f"{script}\n")
