"""Proposing a policy on main of the deployment repository, by a person's account: another person approves it, and the
gate merges it."""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from robotkube.cli.forge_access import REPOSITORY, AccountAtForge, forge_account, reaching
from robotkube.foundation.forge.adapters.git import GitClone, ProposalWriter

PERSON = "operator-team"


@dataclass(frozen=True)
class ProposedPolicy:
    """A policy's text as it was proposed; `url` is that of the pull request, empty when it is only shown."""

    url: str
    commit: str
    text: str


def proposing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of a command that proposes something about an agent."""
    parser.add_argument("agent", metavar="AGENT", help="name of the agent, such as vehicle-00")
    reaching(parser)
    parser.add_argument("--username", default=PERSON, help="your account at the forge; another one approves")
    parser.add_argument("--dry-run", action="store_true", help="only show what would be proposed")


def propose(
    options: argparse.Namespace, path: str, change: Callable[[str | None], str], subject: str, reason: str = ""
) -> ProposedPolicy:
    """Propose the policy at `path` as `change` makes it of main's (None: main has none). The first word of `subject`
    and the agent name the branch."""
    access = forge_account(options, options.username)
    with tempfile.TemporaryDirectory(prefix="robotkube-proposal-") as folder:
        clone = GitClone(access.url, REPOSITORY, access.username, access.password, Path(folder))
        tip = clone.fetch()
        text = change(clone.files(tip, (path.partition("/")[0],)).get(path))
        writer = ProposalWriter(Path(folder), access.username, access.password, access.username, time.time)
        commit = writer.commit(tip, {path: text}, f"{subject}\n\n{reason}".strip() + "\n")
        url = "" if options.dry_run else _pushed(writer, access, commit, subject, options.agent)
    return ProposedPolicy(url, commit[:12], text)


def main_policies(options: argparse.Namespace) -> dict[str, str]:
    """The policies on main, as the person's account reads them."""
    access = forge_account(options, options.username)
    with tempfile.TemporaryDirectory(prefix="robotkube-policies-") as folder:
        clone = GitClone(access.url, REPOSITORY, access.username, access.password, Path(folder))
        return dict(clone.files(clone.fetch(), ("policies",)))


def _pushed(writer: ProposalWriter, access: AccountAtForge, commit: str, subject: str, agent: str) -> str:
    topic = f"{subject.partition(' ')[0].lower()}-{agent}-{commit[:8]}"
    number = writer.propose(commit, topic, subject, "")
    return f"{access.url}/{REPOSITORY}/pulls/{number}" if number else f"{access.url}/{REPOSITORY}/pulls"
