"""The manifest of a recording: a chain over every document that a writer stores, and the seal at its end. Pure.

Each document is an entry of 48 bytes: a digest of its name and one of what it says. Entries go into parts, each part
has the digest of the one before it and of its own entries (`head`), and the first one that of the writer's public key.
The seal is a statement about the last head, signed by that key. What the documents say beyond their digests (when an
index entry was acknowledged, when an audit was written) is not proved.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.robots.recording.core.documents import AUDITS, INDEX, SAMPLES, SEGMENTS

FORM = "robotkube-manifest-1"
PART_ENTRIES_MAX = 1000
NAME_BYTES, ENTRY_BYTES = 16, 48

_FIELDS = {
    INDEX: ("topic", "stamp", "received", "sha256", "size", "volume", "segment", "offset"),
    SEGMENTS: ("volume", "segment", "sha256", "size", "messages", "cut"),
    AUDITS: ("topic", "volume", "life", "window", "received", "stored", "early", "duplicates", "dropped", "unsettled",
             "gaps"),
}  # fmt: skip
_RECORDING_FIELDS = ("rule", "trace", "provenance", "topics", "started", "ended", "counts", "causes", "definitions")
_RENEWED = ("causes", "definitions", "ended", "counts")


def entry_of(collection: str, document: Mapping[str, Any]) -> bytes:
    """The entry of a document: a digest of its name, then one of what it says."""
    return name_of(collection, document) + hashlib.sha256(_CONTENTS[collection](document)).digest()


def name_of(collection: str, document: Mapping[str, Any]) -> bytes:
    """The digest of a document's name."""
    return hashlib.sha256(f"{collection}/{document['_id']}".encode()).digest()[:NAME_BYTES]


def _bucket(document: Mapping[str, Any]) -> bytes:
    parts = [f"{document['topic']}\n{document['second']}\n"]
    parts += [f"{sample['stamp']}:{sample['received']}:{sample['sha256']};" for sample in document["samples"]]
    return "".join(parts).encode()


def _by_fields(names: Sequence[str]) -> Callable[[Mapping[str, Any]], bytes]:
    return lambda document: canonical([document[name] for name in names])


_CONTENTS: dict[str, Callable[[Mapping[str, Any]], bytes]] = {
    SAMPLES: _bucket,
    **{collection: _by_fields(names) for collection, names in _FIELDS.items()},
}


def canonical(value: Any) -> bytes:
    """One sequence of bytes for a value of JSON, whatever order its keys came in."""
    return json.dumps(value, sort_keys=True, separators=(",", ":")).encode()


def is_final(collection: str, document: Mapping[str, Any]) -> bool:
    """Return whether a document will not change any more, as far as entries read it. Audits of the journal's own belong
    to no chain: they go with what it gives up."""
    if collection == SEGMENTS:
        return bool(document["sha256"])
    return collection != AUDITS or (bool(document["closed"]) and not is_journals(document))


def is_journals(audit: Mapping[str, Any]) -> bool:
    """True for an audit of the journal's own: what it gave up on the way to the database."""
    return "-" in str(audit["_id"]).rpartition("/")[2]


def digest_of_recording(document: Mapping[str, Any]) -> str:
    """The digest of what a recording's own document says."""
    return hashlib.sha256(canonical([document.get(name) for name in _RECORDING_FIELDS])).hexdigest()


def continued(prior: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """A recording's document as it is when a writer has resumed it: the earlier one's, with all topics, and with causes
    and end of the later one."""
    if not prior:
        return dict(own)
    renewed = {name: own[name] for name in _RENEWED if name in own}
    return {**prior, **renewed, "topics": {**(prior.get("topics") or {}), **(own.get("topics") or {})}}


@dataclass(frozen=True)
class PriorManifest:
    """What an earlier writer has left of its manifest when another one goes on: its parts, and the last head."""

    life: int
    parts: int
    head: str


GroupKey = tuple[str, str, bool]
"""Collection, topic, whether an earlier writer had stored it unsealed."""


@dataclass
class Chain:
    """The manifest of one writer while it is written. `key`: the public half of the key that will seal it, hex."""

    recording: str
    life: int
    volume: str
    key: str
    parts: int = 0
    documents: int = 0
    adopted: int = 0
    head: str = ""
    _groups: dict[GroupKey, tuple[bytearray, list[int]]] = field(default_factory=dict)
    _waiting: int = 0

    def __post_init__(self) -> None:
        self.head = first_head(self.recording, self.life, self.volume, self.key)

    @property
    def waiting(self) -> int:
        """The number of entries that are in no part yet."""
        return self._waiting

    @property
    def begun(self) -> dict[str, Any]:
        """The document of a manifest that has begun."""
        name = f"{self.recording}/{self.life}"
        known = {"recording": self.recording, "life": self.life, "volume": self.volume, "key": self.key}
        return {"_id": name, **known, "statement": None, "signature": None}

    def add(self, collection: str, document: Mapping[str, Any], adopted: bool = False) -> None:
        """Add a document that was given to the journal, or that an earlier writer has left."""
        topic = "" if collection == SEGMENTS else str(document["topic"])
        entries, messages = self._groups.setdefault((collection, topic, adopted), (bytearray(), [0]))
        entries += entry_of(collection, document)
        messages[0] += len(document["samples"]) if collection == SAMPLES else int(collection == INDEX)
        self._waiting += 1
        self.documents += 1
        self.adopted += adopted

    def cut(self) -> dict[str, Any]:
        """The document of a part with all entries that wait; the chain goes on behind it."""
        groups = [
            {"collection": collection, "topic": topic, "adopted": adopted, "messages": count, "entries": bytes(entries)}
            for (collection, topic, adopted), (entries, [count]) in self._groups.items()
        ]
        self.parts += 1
        name = f"{self.recording}/{self.life}/{self.parts:06d}"
        previous = self.head
        self.head = next_head(previous, groups)
        self._groups = {}
        self._waiting = 0
        known = {"recording": self.recording, "life": self.life, "number": self.parts}
        return {"_id": name, **known, "previous": previous, "groups": groups, "head": self.head}

    def statement(
        self, document: Mapping[str, Any] | None, before: Iterable[PriorManifest], unfinished: Iterable[str]
    ) -> str:
        """The statement to sign. `document`: the recording's own as it ends, None when this writer does not know what
        an earlier one has left; `unfinished`: segments without an end."""
        return canonical({
            "form": FORM, "recording": self.recording, "life": self.life, "volume": self.volume, "key": self.key,
            "parts": self.parts, "head": self.head, "documents": self.documents,
            "document": None if document is None else digest_of_recording(document),
            "before": {str(one.life): [one.parts, one.head] for one in before},
            "unfinished": sorted(unfinished),
        }).decode()  # fmt: skip


def first_head(recording: str, life: int, volume: str, key: str) -> str:
    """The head of a chain without parts: nobody can put another key before it."""
    return hashlib.sha256(canonical([FORM, recording, life, volume, key])).hexdigest()


def next_head(previous: str, groups: Iterable[Mapping[str, Any]]) -> str:
    """The head behind a part with these groups."""
    digest = hashlib.sha256(bytes.fromhex(previous))
    for group in groups:
        entries = bytes(group["entries"])
        known = [group["collection"], group["topic"], bool(group["adopted"]), group["messages"], len(entries)]
        digest.update(canonical(known) + b"\n" + entries)
    return digest.hexdigest()
