"""policies/links/<manager>.yaml: what agents of one manager's scope say to those of others, and hear from them.

    sends:
    - {to: manager-south, topics: ["/vehicles/{agent}/pose"]}
    receives:
    - {from: manager-south, topics: [/vehicles/vehicle_05/pose]}

A scope is called by its manager's name. A topic goes from an agent of one scope to an agent of another when both say
so on main: the scope of who says it by `sends`, that of who hears it by `receives`. A part of a name that is `{agent}`
stands for whatever is there. A scope without a file says nothing to others, and hears nothing of them. Always read
from main.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.patterns import NAME, ROS_TOPIC_PATTERN
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.robots.ros.core.topic_patterns import AGENT

FOLDER = "policies/links"
ENTRIES_MAX = 200

Topics = Mapping[str, tuple[str, ...]]
"""The other scope -> topics."""


@dataclass(frozen=True)
class LinkConsent:
    """What one scope consents to: topics that others may hear, and that its own agents may hear of others."""

    sends: Topics = field(default_factory=dict)
    receives: Topics = field(default_factory=dict)


@dataclass(frozen=True)
class LinkConsents:
    """What every scope consents to, by its name."""

    scopes: Mapping[str, LinkConsent] = field(default_factory=dict)

    def missing(self, topic: str, sender: str, receiver: str) -> tuple[str, ...]:
        """What main lacks for agents of the scope `receiver` to hear a topic of the scope `sender`: file and entry."""
        gives, takes = self.scopes.get(sender, LinkConsent()), self.scopes.get(receiver, LinkConsent())
        sides = (
            (gives.sends.get(receiver, ()), f"{path_of(sender)} sends: {{to: {receiver}, topics: [{topic}]}}"),
            (takes.receives.get(sender, ()), f"{path_of(receiver)} receives: {{from: {sender}, topics: [{topic}]}}"),
        )
        return tuple(words for topics, words in sides if not any(covers(one, topic) for one in topics))


def path_of(scope: str) -> str:
    """The file in which a scope consents."""
    return f"{FOLDER}/{scope}.yaml"


def scope_of(path: str) -> str | None:
    """The scope whose file this would be; None when it is no such file."""
    folder, _, name = path.rpartition("/")
    scope, dot, extension = name.rpartition(".")
    return scope if folder == FOLDER and (dot, extension) == (".", "yaml") and NAME.fullmatch(scope) else None


def covers(consented: str, topic: str) -> bool:
    """Return whether a topic is the one consented to, or one of those."""
    mine, parts = consented.split("/"), topic.split("/")
    return len(mine) == len(parts) and all(one in (AGENT, part) for one, part in zip(mine, parts, strict=True))


def read_consent(text: str, path: str) -> LinkConsent:
    """One scope's file; DocumentError names the key and what may stand there."""
    reader = Reader(path)
    document = reader.mapping(read_mapping(text, path), "", [], ["sends", "receives"])
    consent = LinkConsent(_side(reader, document, "sends", "to"), _side(reader, document, "receives", "from"))
    reader.finish()
    return consent


def read_consents(files: Mapping[str, str], before: LinkConsents) -> tuple[LinkConsents, tuple[str, ...]]:
    """The consents in main's policies (path -> text), and what cannot be read: that scope consents to what it did
    `before`."""
    scopes: dict[str, LinkConsent] = {}
    problems: list[str] = []
    for path, text in sorted(files.items()):
        scope = scope_of(path)
        if scope is None:
            continue
        try:
            scopes[scope] = read_consent(text, path)
        except DocumentError as error:
            problems.append(f"{error}; what {scope} consented to stays so until it is mended or gone")
            if scope in before.scopes:
                scopes[scope] = before.scopes[scope]
    return LinkConsents(scopes), tuple(problems)


def _side(reader: Reader, document: Mapping[str, Any], key: str, word: str) -> Topics:
    topics: dict[str, tuple[str, ...]] = {}
    items: Sequence[Any] = reader.sequence(document.get(key), key)
    if len(items) > ENTRIES_MAX:
        reader.problems.append(f"{key}: {len(items)} entries, at most {ENTRIES_MAX} are allowed")
    for index, item in enumerate(items[:ENTRIES_MAX]):
        where = f"{key}[{index}]"
        entry = reader.mapping(item, where, [word, "topics"])
        other = reader.word(entry.get(word), f"{where}.{word}", NAME)
        names = reader.sequence(entry.get("topics"), f"{where}.topics")
        read = (reader.text(one, f"{where}.topics[{i}]", ROS_TOPIC_PATTERN) for i, one in enumerate(names))
        topics[other] = (*topics.get(other, ()), *read)
    return topics
