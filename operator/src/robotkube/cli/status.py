"""The command `robotkube status`: where main of the deployment repository stands, and what is there unchecked."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from robotkube.cli.forge_access import REPOSITORY, forge_account, reaching
from robotkube.cli.output import Table
from robotkube.delivery.deployment.loops.break_glass import BreakGlassWatch
from robotkube.foundation.forge.adapters.git import GitClone

ACCOUNT = "argocd"  # which reads the repository and nothing else


def asking(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    reaching(parser)
    parser.add_argument("--username", default=ACCOUNT, help="account that reads the deployment repository")


def show_status(options: argparse.Namespace) -> Table:
    """Show each break-glass commit that stands on main; refused when there is one. It reads Git alone, so it answers
    also while the gate is away."""
    access = forge_account(options, options.username)
    with tempfile.TemporaryDirectory(prefix="robotkube-status-") as folder:
        clone = GitClone(access.url, REPOSITORY, access.username, access.password, Path(folder))
        tip = clone.fetch()
        watch = BreakGlassWatch(clone)
        watch.read()
    rows = [
        {
            "commit": glass.commit,
            "time": glass.time,
            "signed_by": list(glass.names),
            "files": list(glass.files),
            "reason": glass.reason,
        }
        for glass in watch.standing
    ]
    found = f"main of {REPOSITORY} is at {tip[:12]}"
    if not rows:
        text = f"{found}; everything on it was checked by the gate or has been replaced\n"
        return Table("break_glass", ("commit", "time", "signed_by", "files", "reason"), rows, text=text)
    count = f"{len(rows)} break-glass commit{'s' if len(rows) > 1 else ''}"
    step = "replace the files, or name the commits in policies/accepted-commits, by a pull request"
    refusal = f"{found}; {count} came without the gate and stand{'s' if len(rows) == 1 else ''}: {step}"
    return Table("break_glass", ("commit", "time", "signed_by", "files", "reason"), rows, refusal=refusal)
