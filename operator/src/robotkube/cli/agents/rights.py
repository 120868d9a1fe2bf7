"""The command `robotkube agent rights`: what an agent may say and hear at the broker, and which commit gave each."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.cli.agents.accounts import declared, declared_agent, history, reading
from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.delivery.deployment.core.borders import Borders
from robotkube.delivery.deployment.core.policies.agents import PATH as AGENTS_PATH
from robotkube.delivery.deployment.core.policies.agents import ROLES
from robotkube.delivery.deployment.core.policies.links import LinkConsents, read_consents
from robotkube.delivery.deployment.loops.main_history import POLICIES
from robotkube.delivery.rights.core.accounts import Accounts, AgentAccount, fixed_rights
from robotkube.delivery.rights.core.grants import borders_of, topics_of
from robotkube.delivery.rights.core.origins import Origin, enrollments, origins, revocations
from robotkube.errors import InputError

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
    give, each with the commit that gave it. Topics that say types of these go along. What another scope's agents say is
    among it where both scopes consent; without a cluster (--role) it is not known whose an agent is."""
    agent, accounts = _agent(options)
    with history(options) as main:
        commits = main.commits({})
        policies = main.files(commits[-1].id, (POLICIES,)) if commits else {}
    if revoked := revocations(commits).get(agent.name):
        words = f"{agent.name} is revoked by commit {revoked.commit.id[:12]}, and has no rights: {revoked.reason}\n"
        return Table("rights", COLUMNS, [], text=words)
    accounts = accounts.with_enrolled({name: one.role for name, one in enrollments(commits).items()})
    agent = declared_agent(accounts, agent.name)
    if not agent.role:
        words = f"{agent.name} is reserved, and has no rights until {AGENTS_PATH} on main enrolls it\n"
        return Table("rights", COLUMNS, [], text=words)
    borders = borders_of(accounts, read_consents(policies, LinkConsents())[0])
    given = [row for origin in origins(commits, agent) for row in _given(origin, borders)]
    return Table("rights", COLUMNS, [*_always(agent), *given])


def _agent(options: argparse.Namespace) -> tuple[AgentAccount, Accounts]:
    """The agent's account, as the arguments say, or as the platform's settings do, and all accounts: of the arguments
    no manager's, so there are no borders between scopes."""
    if options.role:
        agent = AgentAccount(options.agent, options.role, options.agent)
        return agent, Accounts((agent,), ())
    if options.clone or options.forge_url:
        raise InputError("--clone and --forge-url ask no cluster: give the agent's --role")
    accounts = declared(Platform(options))
    return declared_agent(accounts, options.agent), accounts


def _always(agent: AgentAccount) -> Sequence[Mapping[str, Any]]:
    rights = sorted(fixed_rights(Accounts((agent,), ()))[agent.name], key=lambda right: (right.direction, right.topic))
    return [
        {"may": right.direction, "topic": right.topic, "given_by": ALWAYS, "commit": "", "subject": ""}
        for right in reversed(rights)
    ]


def _given(origin: Origin, borders: Borders) -> Sequence[Mapping[str, Any]]:
    return [
        {
            "may": "read",
            "topic": topic,
            "given_by": origin.grant.release,
            "commit": origin.commit.id[:12],
            "subject": origin.commit.subject,
        }
        for topic in topics_of(origin.grant, borders)
    ]
