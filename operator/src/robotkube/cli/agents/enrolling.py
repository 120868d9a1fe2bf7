"""The commands `robotkube agent enroll` and `robotkube agent withdraw`: a reserved agent becomes one of the fleet by an
entry of main, and leaves it with that entry. Enrolled, it gets one file for its machine."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path

from robotkube.cli.agents.accounts import declared, declared_agent
from robotkube.cli.agents.joining import give_token, join_file, new_token, write_secret_file
from robotkube.cli.agents.proposing import main_policies, propose, proposing
from robotkube.cli.output import Table
from robotkube.cli.platform import Platform
from robotkube.delivery.deployment.core.policies.agents import PATH, ROLES, read_enrolled, write_enrolled
from robotkube.delivery.deployment.core.policies.revoked import PATH as REVOKED_PATH
from robotkube.delivery.deployment.core.policies.revoked import read_revoked
from robotkube.errors import InputError, RefusalError

COLUMNS = ("agent", "role", "pull_request", "commit", "policy", "file", "expires")
HOURS, HOURS_MAX = 1, 24

Enrolled = Mapping[str, str]


def enrolling(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `enroll`."""
    proposing(parser)
    parser.add_argument("--role", required=True, choices=ROLES, help="what the agent is")
    parser.add_argument(
        "--file", type=Path, metavar="FILE", help="the file for its machine (default: <agent>.kubeconfig)"
    )
    parser.add_argument(
        "--hours", type=int, default=HOURS, help=f"how long the file's token is good, at most {HOURS_MAX}"
    )
    parser.add_argument(
        "--server", metavar="URL", help="the API server as the machine reaches it (default: that of the kubeconfig)"
    )


def withdrawing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `withdraw`."""
    proposing(parser)
    parser.add_argument("--reason", required=True, metavar="TEXT", help="why, in one line; it stands in the commit")


def enroll_agent(options: argparse.Namespace) -> Table:
    """Propose that a reserved agent be enrolled; once main enrolls it, write the file with which its machine joins."""
    if not 1 <= options.hours <= HOURS_MAX:
        raise InputError(f"--hours {options.hours}: must be 1 to {HOURS_MAX}")
    if not options.forge_url:
        _check_reserved(Platform(options), options.agent)
    policies = main_policies(options)
    enrolled = read_enrolled(policies.get(PATH))
    if options.agent not in enrolled:
        return _proposed(options, lambda now: {**now, options.agent: options.role}, "Enroll", "", options.role)
    if enrolled[options.agent] != options.role:
        problem = f"{options.agent} is enrolled as {enrolled[options.agent]}: withdraw it first, then enroll it anew"
        raise RefusalError("EnrolledOtherwise", problem)
    revoked = policies.get(REVOKED_PATH)
    if options.agent in ({} if revoked is None else read_revoked(revoked)):
        raise RefusalError("Revoked", f"{options.agent} is revoked: robotkube agent restore {options.agent} first")
    return _file(options)


def withdraw_agent(options: argparse.Namespace) -> Table:
    """Propose that an enrolled agent be reserved again: its releases go, and its account at the broker is shut."""

    def removed(enrolled: Enrolled) -> Enrolled:
        if options.agent not in enrolled:
            problem = f"{options.agent} is not enrolled; on main are: {', '.join(sorted(enrolled)) or 'none'}"
            raise RefusalError("NotEnrolled", problem)
        return {agent: role for agent, role in enrolled.items() if agent != options.agent}

    return _proposed(options, removed, "Withdraw", options.reason)


def _check_reserved(platform: Platform, name: str) -> None:
    accounts = declared(platform)
    if declared_agent(accounts, name).role:
        raise RefusalError("DeclaredByValues", f"{name} is declared by the chart's values, and needs no enrollment")


def _proposed(
    options: argparse.Namespace, change: Callable[[Enrolled], Enrolled], verb: str, reason: str, role: str = ""
) -> Table:
    """Propose policies/agents.yaml as `change` makes it of main's."""
    subject = f"{verb} {options.agent}{f' as {role}' if role else ''}"
    made = propose(options, PATH, lambda text: write_enrolled(change(read_enrolled(text))), subject, reason)
    row = {"agent": options.agent, "role": role, "pull_request": made.url, "commit": made.commit, "policy": made.text}
    text = f"{subject}: {made.url}\nIt waits for another person's approval; until then nothing changes.\n"
    text += "Then run this command again: it writes the file for the machine.\n" if role else ""
    row |= {"file": "", "expires": ""}
    return Table("proposal", COLUMNS, [row], single=True, text=text if made.url else f"{PATH} would be:\n{made.text}")


def _file(options: argparse.Namespace) -> Table:
    """Write the file of an enrolled agent."""
    platform = Platform(options)
    path = options.file or Path(f"{options.agent}.kubeconfig")
    server, authority = platform.api_server()
    token = new_token(options.agent, datetime.now(UTC), options.hours)
    row = {"agent": options.agent, "role": options.role, "pull_request": "", "commit": "", "policy": ""}
    row |= {"file": str(path), "expires": token.expires}
    if options.dry_run:
        return Table(
            "file", COLUMNS, [row], single=True, text=f"{options.agent} is enrolled; {path} would be written.\n"
        )
    write_secret_file(path, join_file(token, options.role, options.server or server, authority))
    try:
        give_token(platform, token)
    except BaseException:
        path.unlink()
        raise
    text = (
        f"{options.agent} is enrolled as {options.role}. {path} is for its machine, which joins with it until "
        f"{token.expires}. Whoever has the file can join as a Node: carry it as you would a key.\n"
    )
    return Table("file", COLUMNS, [row], single=True, text=text)
