"""Which commit of main gave each right that stands, and which revoked whom: the last one before which main did not say
so."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from robotkube.delivery.deployment.core.policies.agents import PATH as AGENTS_PATH
from robotkube.delivery.deployment.core.policies.agents import read_enrolled
from robotkube.delivery.deployment.core.policies.revoked import PATH as REVOKED_PATH
from robotkube.delivery.deployment.core.policies.revoked import read_revoked
from robotkube.delivery.deployment.core.releases import RELEASES, read_release
from robotkube.delivery.rights.core.accounts import Accounts, AgentAccount
from robotkube.delivery.rights.core.grants import Grant, granted
from robotkube.errors import DocumentError
from robotkube.foundation.forge.core.histories import HistoryCommit


@dataclass(frozen=True)
class Origin:
    """A grant that stands on main, and the commit that gave it."""

    grant: Grant
    commit: HistoryCommit


@dataclass(frozen=True)
class Revocation:
    """Why an agent may not be at the broker, and the commit that says so."""

    reason: str
    commit: HistoryCommit


def revocations(commits: Iterable[HistoryCommit]) -> dict[str, Revocation]:
    """Who is revoked at the last of main's commits (oldest first); a file that cannot be read changes nothing, as at
    the broker."""
    named, since = _entries(commits, REVOKED_PATH, lambda text: {} if text is None else read_revoked(text))
    return {agent: Revocation(reason, since[agent]) for agent, reason in named.items()}


@dataclass(frozen=True)
class Enrollment:
    """The role that main gives a reserved agent, and the commit since which it is enrolled."""

    role: str
    commit: HistoryCommit


def enrollments(commits: Iterable[HistoryCommit]) -> dict[str, Enrollment]:
    """Who is enrolled at the last of main's commits (oldest first); a file that cannot be read changes nothing, as at
    the broker."""
    named, since = _entries(commits, AGENTS_PATH, read_enrolled)
    return {agent: Enrollment(role, since[agent]) for agent, role in named.items()}


def _entries(
    commits: Iterable[HistoryCommit], path: str, read: Callable[[str | None], Mapping[str, str]]
) -> tuple[Mapping[str, str], dict[str, HistoryCommit]]:
    """What the file at `path` says of each agent at the last of the commits, and since which commit it names it."""
    named: Mapping[str, str] = {}
    since: dict[str, HistoryCommit] = {}
    for commit in commits:
        if path in commit.changes:
            try:
                named = read(commit.changes[path])
            except DocumentError:
                continue
            since = {agent: since.get(agent, commit) for agent in named}
    return named, since


def origins(commits: Iterable[HistoryCommit], agent: AgentAccount) -> list[Origin]:
    """The grants of an agent at the last of main's commits (oldest first), each with the commit that gave it."""
    accounts = Accounts((agent,), ())
    prefix = f"{RELEASES}/{agent.namespace}/"
    standing: dict[str, dict[Grant, Origin]] = {}
    for commit in commits:
        for path, text in commit.changes.items():
            if path.startswith(prefix):
                _apply(standing, path, text, commit, accounts)
    return sorted((one for every in standing.values() for one in every.values()), key=lambda one: one.grant)


def _apply(
    standing: dict[str, dict[Grant, Origin]], path: str, text: str | None, commit: HistoryCommit, accounts: Accounts
) -> None:
    """Keep what a commit says of one release; a file that cannot be read changes nothing, as at the broker."""
    if text is None:
        standing.pop(path, None)
        return
    try:
        grants = granted(read_release(text, path), accounts).grants
    except DocumentError:
        return
    before = standing.get(path, {})
    standing[path] = {grant: before.get(grant) or Origin(grant, commit) for grant in grants}
