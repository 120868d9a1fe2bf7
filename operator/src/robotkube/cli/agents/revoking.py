"""The commands `robotkube agent revoke` and `robotkube agent restore`: a proposal that an agent's account at the broker
be shut, or let in again. Another person approves it, the gate merges it, and the process `rights` carries it out."""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from robotkube.cli.agents.accounts import declared, declared_agent
from robotkube.cli.forge_access import REPOSITORY, AccountAtForge, forge_account, reaching
from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.delivery.deployment.core.policies.revoked import PATH, read_revoked, write_revoked
from robotkube.errors import RefusalError
from robotkube.foundation.forge.adapters.git import GitClone, ProposalWriter

PERSON = "operator-team"
COLUMNS = ("agent", "reason", "pull_request", "commit", "file")

Revoked = Mapping[str, str]


def _naming(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("agent", metavar="AGENT", help="name of the agent, such as vehicle-00")
    reaching(parser)
    parser.add_argument("--username", default=PERSON, help="your account at the forge; another one approves")
    parser.add_argument("--dry-run", action="store_true", help="only show what would be proposed")


def revoking(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `revoke`."""
    _naming(parser)
    parser.add_argument("--reason", required=True, metavar="TEXT", help="why, in one line; it stands on main")


def restoring(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `restore`."""
    _naming(parser)


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
    access = forge_account(options, options.username)
    with tempfile.TemporaryDirectory(prefix="robotkube-revoke-") as folder:
        clone = GitClone(access.url, REPOSITORY, access.username, access.password, Path(folder))
        tip = clone.fetch()
        text = clone.files(tip, (PATH.partition("/")[0],)).get(PATH)
        new = write_revoked(change({} if text is None else read_revoked(text)))
        writer = ProposalWriter(Path(folder), access.username, access.password, access.username, time.time)
        commit = writer.commit(tip, {PATH: new}, f"{subject}\n\n{reason}".strip() + "\n")
        url = "" if options.dry_run else _pushed(writer, access, commit, subject, options.agent)
    row = {"agent": options.agent, "reason": reason, "pull_request": url, "commit": commit[:12], "file": new}
    text = f"{subject}: {url}\nIt waits for another person's approval; until then nothing changes at the broker.\n"
    return Table("proposal", COLUMNS, [row], single=True, text=text if url else f"{PATH} would be:\n{new}")


def _pushed(writer: ProposalWriter, access: AccountAtForge, commit: str, subject: str, agent: str) -> str:
    topic = f"{subject.partition(' ')[0].lower()}-{agent}-{commit[:8]}"
    number = writer.propose(commit, topic, subject, "")
    return f"{access.url}/{REPOSITORY}/pulls/{number}" if number else f"{access.url}/{REPOSITORY}/pulls"
