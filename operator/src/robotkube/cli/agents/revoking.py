"""The commands `robotkube agent revoke` and `robotkube agent restore`: a proposal that an agent's account at the broker
be shut, or let in again. Another person approves it, the gate merges it, and the process `rights` carries it out."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping

from robotkube.cli.agents.accounts import declared, declared_agent
from robotkube.cli.agents.proposing import propose, proposing
from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.delivery.deployment.core.policies.revoked import PATH, read_revoked, write_revoked
from robotkube.errors import RefusalError

COLUMNS = ("agent", "reason", "pull_request", "commit", "file")

Revoked = Mapping[str, str]


def revoking(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `revoke`."""
    proposing(parser)
    parser.add_argument("--reason", required=True, metavar="TEXT", help="why, in one line; it stands on main")


def restoring(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `restore`."""
    proposing(parser)


def revoke_agent(options: argparse.Namespace) -> Table:
    """Propose that an agent's connections at the broker end, and none begins."""
    if not options.forge_url:
        declared_agent(declared(Platform(options)), options.agent)

    def added(revoked: Revoked) -> Revoked:
        if options.agent in revoked:
            problem = f"{options.agent} is revoked already: {revoked[options.agent]}"
            raise RefusalError("AlreadyRevoked", problem)
        return read_revoked(write_revoked({**revoked, options.agent: options.reason}))

    return _propose(options, added, f"Revoke {options.agent}", options.reason)


def restore_agent(options: argparse.Namespace) -> Table:
    """Propose that a revoked agent may be at the broker again."""

    def removed(revoked: Revoked) -> Revoked:
        if options.agent not in revoked:
            problem = f"{options.agent} is not revoked; on main are: {', '.join(sorted(revoked)) or 'none'}"
            raise RefusalError("NotRevoked", problem)
        return {agent: reason for agent, reason in revoked.items() if agent != options.agent}

    return _propose(options, removed, f"Restore {options.agent}", "")


def _propose(options: argparse.Namespace, change: Callable[[Revoked], Revoked], subject: str, reason: str) -> Table:
    """Propose policies/revoked.yaml as `change` makes it of main's."""

    def changed(text: str | None) -> str:
        return write_revoked(change({} if text is None else read_revoked(text)))

    made = propose(options, PATH, changed, subject, reason)
    row = {"agent": options.agent, "reason": reason, "pull_request": made.url}
    text = f"{subject}: {made.url}\nIt waits for another person's approval; until then nothing changes at the broker.\n"
    row |= {"commit": made.commit, "file": made.text}
    return Table("proposal", COLUMNS, [row], single=True, text=text if made.url else f"{PATH} would be:\n{made.text}")
