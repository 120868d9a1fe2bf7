"""What releases on main give to read: the topics that they bring in from the broker.

What cannot be read gives nothing, and is said. Whose right it is follows from the namespace alone, which is that of the
file's path: what else a release says about agents gives nothing. What another scope's agents say is given where both
scopes consent.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from robotkube.delivery.deployment.core.borders import Borders, said_as, scopes_of, speaker
from robotkube.delivery.deployment.core.heard_topics import heard_topics
from robotkube.delivery.deployment.core.policies.agents import PATH as AGENTS_PATH
from robotkube.delivery.deployment.core.policies.agents import not_reserved, read_enrolled
from robotkube.delivery.deployment.core.policies.links import LinkConsents, read_consents
from robotkube.delivery.deployment.core.policies.revoked import PATH as REVOKED_PATH
from robotkube.delivery.deployment.core.policies.revoked import read_revoked
from robotkube.delivery.deployment.core.releases import RELEASES, Release, Tree
from robotkube.delivery.rights.core.accounts import ASK, READ, Accounts, Right, Table, fixed_rights, with_types
from robotkube.errors import DocumentError
from robotkube.robots.mqtt.core.message_properties import MQTT_PREFIX
from robotkube.robots.ros.core.topic_patterns import AGENT


@dataclass(frozen=True, order=True)
class Grant:
    """A topic that a release gives its agent to read: `name` is the ROS topic, `topic` the filter at the broker."""

    agent: str
    release: str
    name: str
    topic: str


@dataclass(frozen=True)
class Granted:
    """The grants of one release, and what in it cannot be read."""

    grants: tuple[Grant, ...] = ()
    problems: tuple[str, ...] = ()


def granted(release: Release, accounts: Accounts) -> Granted:
    """What a release gives; nothing where its namespace is no agent's."""
    account = accounts.of_namespace(release.namespace)
    if account is None:
        return Granted()
    grants: set[Grant] = set()
    problems: list[str] = []
    for heard in heard_topics(release.values):
        if heard.filter:
            grants.add(Grant(account.name, release.key, heard.name, heard.filter))
        else:
            where = f"{release.path}: {heard.where}"
            problems.append(f"{where}: is no topic that can be given to read; nothing is given for it")
    return Granted(tuple(sorted(grants)), tuple(problems))


def borders_of(accounts: Accounts, consents: LinkConsents) -> Borders:
    """The borders between the scopes of the managers."""
    return Borders(scopes_of((manager.name, manager.agents) for manager in accounts.managers), consents)


def topics_of(grant: Grant, borders: Borders) -> list[str]:
    """The filters at the broker of what a grant gives to hear, without what says their types: nothing where its topic
    may not go over a border, and of one that names any agent those whose topic may."""
    topic = said_as(grant.topic)
    if borders.missing(topic, grant.agent):
        return []
    if not borders.scopes or speaker(topic) != AGENT:
        return [grant.topic]
    return [MQTT_PREFIX + named for named in borders.heard_of(topic, grant.agent)]


def rights_of(grant: Grant, borders: Borders) -> Iterator[Right]:
    """The rights at the broker of a grant. The filter that is subscribed to is the grant's, so a bridge notices nothing
    of consents that come and go."""
    heard = topics_of(grant, borders)
    for topic in heard:
        yield from (Right(one, READ) for one in with_types(topic))
    if heard and grant.topic not in heard:
        yield from (Right(one, ASK) for one in with_types(grant.topic))


@dataclass(frozen=True)
class MainTable:
    """The rights at one commit of main: the table, and what gave its variable part, by the release's path. `revoked`:
    agents that may not be at the broker, each with the reason; None: the file that says it could never be read.
    `consents`: what scopes let pass their borders. `enrolled`: the reserved agents that main enrolls, each with its
    role; `reserved`: those that it does not."""

    commit: str
    table: Table
    granted: Mapping[str, Granted] = field(default_factory=dict)
    problems: tuple[str, ...] = ()
    revoked: Mapping[str, str] | None = field(default_factory=dict)
    consents: LinkConsents = field(default_factory=LinkConsents)
    enrolled: Mapping[str, str] = field(default_factory=dict)
    reserved: frozenset[str] = frozenset()

    @property
    def shut(self) -> frozenset[str] | None:
        """The accounts that nobody may use: of agents that are revoked, or not enrolled; None: it is not known."""
        return None if self.revoked is None else self.reserved.union(self.revoked)


def main_table(
    commit: str, tree: Tree, accounts: Accounts, before: MainTable | None, policies: Mapping[str, str]
) -> MainTable:
    """The table at a commit; `policies` are its policies, as text. A file that cannot be read keeps what it said
    `before`: it is broken, and not withdrawn. Who is revoked or not enrolled has no rights. DocumentError when who is
    enrolled was never read: the roles of agents, and so their rights, are not known."""
    enrolled, unusable = _enrolled(policies.get(AGENTS_PATH), accounts, before)
    accounts = accounts.with_enrolled(enrolled)
    known = before.granted if before else {}
    broken = [path for path in tree.suspects if path.startswith(f"{RELEASES}/") and path not in tree.releases]
    kept = {path: known[path] for path in broken if path in known}
    every = {**{path: granted(release, accounts) for path, release in tree.releases.items()}, **kept}
    consents, unread = read_consents(policies, before.consents if before else LinkConsents())
    borders = borders_of(accounts, consents)
    table = fixed_rights(accounts)
    for one in every.values():
        for grant in one.grants:
            table[grant.agent] |= frozenset(rights_of(grant, borders))
    revoked, wrong = _revoked(policies.get(REVOKED_PATH), accounts, before)
    table |= dict.fromkeys(accounts.reserved.union(revoked or ()), frozenset())
    unreadable = (f"{path}: cannot be read; what it gave before stays, until it is mended or gone" for path in broken)
    problems = (*unusable, *unreadable, *unread, *wrong, *_problems(every, borders))
    given = {path: one for path, one in every.items() if one.grants or one.problems}
    return MainTable(commit, table, given, problems, revoked, consents, enrolled, accounts.reserved)


def _enrolled(
    text: str | None, accounts: Accounts, before: MainTable | None
) -> tuple[Mapping[str, str], tuple[str, ...]]:
    """The reserved agents that main enrolls, and what is wrong with that."""
    try:
        named = read_enrolled(text)
    except DocumentError as error:
        if before is None:
            raise
        return before.enrolled, (f"{error}; who is enrolled stays so until it is mended",)
    declared = {agent.name for agent in accounts.agents}
    wrong = not_reserved(named, accounts.reserved, declared)
    return {name: role for name, role in named.items() if name in accounts.reserved}, tuple(wrong)


def _problems(every: Mapping[str, Granted], borders: Borders) -> Iterator[str]:
    """What in releases gives nothing, and why."""
    for path, one in every.items():
        yield from one.problems
        obstacles = (borders.obstacle(said_as(grant.topic), grant.agent) for grant in one.grants)
        yield from (f"{path}: {obstacle}" for obstacle in obstacles if obstacle)


def _revoked(
    text: str | None, accounts: Accounts, before: MainTable | None
) -> tuple[Mapping[str, str] | None, tuple[str, ...]]:
    """Who is revoked, and what is wrong with that."""
    try:
        named = {} if text is None else read_revoked(text)
    except DocumentError as error:
        return before.revoked if before else None, (f"{error}; who is revoked stays so until it is mended or gone",)
    agents = {agent.name for agent in accounts.agents}
    wrong = (f"{REVOKED_PATH}: no agent {name} is declared; nobody is revoked by it" for name in named.keys() - agents)
    return {name: reason for name, reason in named.items() if name in agents}, tuple(sorted(wrong))
