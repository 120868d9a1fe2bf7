"""The command `robotkube agent rights`: what an agent may say and hear at the broker, and which commit gave each."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from robotkube.cli.forge_access import REPOSITORY, forge_account, reaching
from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.delivery.rights.core.accounts import Accounts, AgentAccount, fixed_rights
from robotkube.delivery.rights.core.origins import Origin, origins
from robotkube.delivery.rights.settings import read_accounts
from robotkube.errors import InputError
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.foundation.forge.adapters.git import GitHistory, fetch_history

ACCOUNT = "argocd"  # which reads the repository and nothing else
ROLES = ("vehicle", "roadside", "edge", "cloud")
COLUMNS = ("may", "topic", "given_by", "commit", "subject")
ALWAYS = "always"


def asking(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("agent", metavar="AGENT", help="name of the agent, such as vehicle-00")
    reaching(parser)
    parser.add_argument("--username", default=ACCOUNT, help="account that reads the deployment repository")
    parser.add_argument("--clone", type=Path, metavar="FOLDER", help="read this clone of the deployment repository")
    parser.add_argument(
        "--role",
        choices=ROLES,
        help="the agent's role; needed with --clone or --forge-url, which ask no cluster",
    )


def show_rights(options: argparse.Namespace) -> Table:
    """Show what the broker's table has for an agent when it is that of main: what it may always, and what releases
    give, each with the commit that gave it. Topics that say types of these go along."""
    agent = _agent(options)
    with tempfile.TemporaryDirectory(prefix="robotkube-rights-") as folder:
        clone = options.clone or Path(folder) / "deployment.git"
        if not options.clone:
            access = forge_account(options, options.username)
            fetch_history(access.url, REPOSITORY, access.username, access.password, clone)
        commits = GitHistory(clone).commits({})
    return Table("rights", COLUMNS, [*_always(agent), *map(_given, origins(commits, agent))])


def _agent(options: argparse.Namespace) -> AgentAccount:
    """The agent's account: as the arguments say, or as the platform's settings do."""
    if options.role:
        return AgentAccount(options.agent, options.role, options.agent)
    if options.clone or options.forge_url:
        raise InputError("--clone and --forge-url ask no cluster: give the agent's --role")
    accounts = _accounts(Platform(options).rights_settings())
    for agent in accounts.agents:
        if agent.name == options.agent:
            return agent
    known = ", ".join(agent.name for agent in accounts.agents) or "none"
    raise InputError(f"no agent {options.agent} is declared; there are: {known}")


def _accounts(text: str) -> Accounts:
    where = "ConfigMap rights, config.yaml"
    reader = Reader(where)
    accounts = read_accounts(reader, read_mapping(text, where))
    reader.finish()
    return accounts


def _always(agent: AgentAccount) -> Sequence[Mapping[str, Any]]:
    rights = sorted(fixed_rights(Accounts((agent,), ()))[agent.name], key=lambda right: (right.direction, right.topic))
    return [
        {"may": right.direction, "topic": right.topic, "given_by": ALWAYS, "commit": "", "subject": ""}
        for right in reversed(rights)
    ]


def _given(origin: Origin) -> Mapping[str, Any]:
    return {
        "may": "read",
        "topic": origin.grant.topic,
        "given_by": origin.grant.release,
        "commit": origin.commit.id[:12],
        "subject": origin.commit.subject,
    }
