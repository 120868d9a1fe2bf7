"""The command `robotkube agent rights`: what an agent may say and hear at the broker, and which commit gave each."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.cli.agents.accounts import declared, declared_agent, history, reading
from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.delivery.rights.core.accounts import Accounts, AgentAccount, fixed_rights
from robotkube.delivery.rights.core.origins import Origin, origins, revocations
from robotkube.errors import InputError

ROLES = ("vehicle", "roadside", "edge", "cloud")
COLUMNS = ("may", "topic", "given_by", "commit", "subject")
ALWAYS = "always"


def asking(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("agent", metavar="AGENT", help="name of the agent, such as vehicle-00")
    reading(parser)
    parser.add_argument(
        "--role",
        choices=ROLES,
        help="the agent's role; needed with --clone or --forge-url, which ask no cluster",
    )


def show_rights(options: argparse.Namespace) -> Table:
    """Show what the broker's table has for an agent when it is that of main: what it may always, and what releases
    give, each with the commit that gave it. Topics that say types of these go along."""
    agent = _agent(options)
    with history(options) as main:
        commits = main.commits({})
    if revoked := revocations(commits).get(agent.name):
        words = f"{agent.name} is revoked by commit {revoked.commit.id[:12]}, and has no rights: {revoked.reason}\n"
        return Table("rights", COLUMNS, [], text=words)
    return Table("rights", COLUMNS, [*_always(agent), *map(_given, origins(commits, agent))])


def _agent(options: argparse.Namespace) -> AgentAccount:
    """The agent's account: as the arguments say, or as the platform's settings do."""
    if options.role:
        return AgentAccount(options.agent, options.role, options.agent)
    if options.clone or options.forge_url:
        raise InputError("--clone and --forge-url ask no cluster: give the agent's --role")
    return declared_agent(declared(Platform(options)), options.agent)


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
