"""What releases on main give to read: the topics that the values of a release say are brought in from the broker.

    bridge:   {in: [{name: /vehicles/vehicle_01/pose, mqtt_topic: ...}]}         a bridge, at the end of links
    detector: {topics: [{name: "/vehicles/{agent}/pose", source: mqtt}]}         a detector that reads the broker itself

They are read by this form, whatever the chart is: a chart of one's own that takes its topics under `bridge.in` is a
bridge like ours. What cannot be read gives nothing, and is said. Whose right it is follows from the namespace alone,
which is that of the file's path: what else a release says about agents gives nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from robotkube.delivery.deployment.core.policies.revoked import PATH as REVOKED_PATH
from robotkube.delivery.deployment.core.policies.revoked import read_revoked
from robotkube.delivery.deployment.core.releases import RELEASES, Release, Tree
from robotkube.delivery.rights.core.accounts import READ, Accounts, Right, Table, fixed_rights, with_types
from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.patterns import MQTT_TOPIC, ROS_TOPIC_PATTERN
from robotkube.robots.bridge.core.settings import GATEWAY_TOPICS, BridgedTopic
from robotkube.robots.ros.core.topic_patterns import AGENT

OF_THE_PLATFORM = ("robotkube/", "mqtt_client/")
"""Beginnings of topics of which nobody is given one by itself: the task gateway, and what says types."""


@dataclass(frozen=True, order=True)
class Grant:
    """A topic that a release gives its agent to read: `name` is the ROS topic, `topic` the filter at the broker."""

    agent: str
    release: str
    name: str
    topic: str

    @property
    def rights(self) -> frozenset[Right]:
        """The rights at the broker."""
        return frozenset(Right(topic, READ) for topic in with_types(self.topic))


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
    for where, item in _read_topics(release.values):
        name = item.get("name") if isinstance(item, Mapping) else None
        if name in GATEWAY_TOPICS:
            continue  # everybody has his own
        topic = _filter(item)
        if topic:
            grants.add(Grant(account.name, release.key, str(name), topic))
        else:
            problems.append(f"{release.path}: {where}: is no topic that can be given to read; nothing is given for it")
    return Granted(tuple(sorted(grants)), tuple(problems))


def _read_topics(values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """What the values say is read from the broker, with its place in them."""
    for index, item in enumerate(_items(values, "bridge", "in")):
        yield f"bridge.in[{index}]", item
    for index, item in enumerate(_items(values, "detector", "topics")):
        if isinstance(item, Mapping) and item.get("source") == "mqtt":
            yield f"detector.topics[{index}]", {"name": item.get("name")}


def _items(values: Mapping[str, Any], outer: str, inner: str) -> list[Any]:
    mapping = values.get(outer)
    items = mapping.get(inner) if isinstance(mapping, Mapping) else None
    return items if isinstance(items, list) else []


def _filter(item: Any) -> str:
    """The filter at the broker of a topic in a release's values; empty when there is none to be given."""
    name = item.get("name") if isinstance(item, Mapping) else None
    if not isinstance(name, str) or not ROS_TOPIC_PATTERN.fullmatch(name) or name.count(AGENT) > 1:
        return ""
    other = item.get("mqtt_topic") or ""
    if other and not (isinstance(other, str) and MQTT_TOPIC.fullmatch(other)):
        return ""
    topic = BridgedTopic(name, "", mqtt_topic=other).filter
    return "" if topic.startswith(OF_THE_PLATFORM) else topic


@dataclass(frozen=True)
class MainTable:
    """The rights at one commit of main: the table, and what gave its variable part, by the release's path. `revoked`:
    agents that may not be at the broker, each with the reason; None: the file that says it could never be read."""

    commit: str
    table: Table
    granted: Mapping[str, Granted] = field(default_factory=dict)
    problems: tuple[str, ...] = ()
    revoked: Mapping[str, str] | None = field(default_factory=dict)


def main_table(
    commit: str, tree: Tree, accounts: Accounts, before: MainTable | None, revoked_text: str | None = None
) -> MainTable:
    """The table at a commit; `revoked_text` is that of policies/revoked.yaml. A file that cannot be read keeps what it
    said `before`: it is broken, and not withdrawn. Who is revoked has no rights."""
    known = before.granted if before else {}
    broken = [path for path in tree.suspects if path.startswith(f"{RELEASES}/") and path not in tree.releases]
    kept = {path: known[path] for path in broken if path in known}
    every = {**{path: granted(release, accounts) for path, release in tree.releases.items()}, **kept}
    table = fixed_rights(accounts)
    for one in every.values():
        for grant in one.grants:
            table[grant.agent] |= grant.rights
    revoked, wrong = _revoked(revoked_text, accounts, before)
    table |= dict.fromkeys(revoked or (), frozenset())
    unreadable = (f"{path}: cannot be read; what it gave before stays, until it is mended or gone" for path in broken)
    problems = (*unreadable, *wrong, *(text for one in every.values() for text in one.problems))
    given = {path: one for path, one in every.items() if one.grants or one.problems}
    return MainTable(commit, table, given, problems, revoked)


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
