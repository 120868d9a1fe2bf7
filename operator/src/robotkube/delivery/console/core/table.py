"""The table behind the console's page: items by kind and key, and what changed after a version.

Every change makes the version one more. What changed after a version is the newest document of each item that is
there, and the key of each that went: so who is slow gets fewer and larger answers, loses nothing that is still there
and gets nothing twice. Only who asks after a version from before the oldest item that went and is still remembered
cannot be told: he reads the whole table anew.
"""

from __future__ import annotations

import json
import math
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

AGENTS, POSES, TASKS, PLANS, RELEASES, PODS = "agents", "poses", "tasks", "plans", "releases", "pods"
EVENTS, RULES, CATALOGUE, STRANGERS, SOURCES = "events", "rules", "catalogue", "strangers", "sources"
LINKS, RECORDINGS, UNCHECKED, CERTIFICATES = "links", "recordings", "unchecked", "certificates"
KINDS = (
    AGENTS, POSES, TASKS, PLANS, RELEASES, PODS, EVENTS, RULES, CATALOGUE, STRANGERS, UNCHECKED, LINKS, RECORDINGS,
    CERTIFICATES, SOURCES,
)  # fmt: skip
GONE_MAX = 10_000

Document = Mapping[str, Any]


@dataclass(frozen=True)
class Item:
    """One item as of `version`: its document, and that as JSON text, which is made once for all who read it."""

    version: int
    document: Document
    text: str


@dataclass(frozen=True)
class TableChange:
    """What changed up to `version`: texts of items by kind and key, and keys of items that went."""

    version: int
    items: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    gone: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.items or self.gone)


class ItemTable:
    """The items. Not for several threads."""

    def __init__(self, gone_max: int = GONE_MAX) -> None:
        self.version = 0
        self._gone_max = gone_max
        self._items: dict[str, dict[str, Item]] = {kind: {} for kind in KINDS}
        self._changed: OrderedDict[tuple[str, str], int] = OrderedDict()  # oldest first; also of what went
        self._gone: OrderedDict[tuple[str, str], int] = OrderedDict()
        self._floor = 0

    def put(self, kind: str, key: str, document: Document) -> bool:
        """Put an item in, as `readable` makes it; False when it is there already, as it is."""
        document, text = readable(document)
        before = self._items[kind].get(key)
        if before is not None and before.text == text:
            return False
        self._note(kind, key)
        self._gone.pop((kind, key), None)
        self._items[kind][key] = Item(self.version, document, text)
        return True

    def remove(self, kind: str, key: str) -> bool:
        """Take an item out; False when there is none."""
        if self._items[kind].pop(key, None) is None:
            return False
        self._note(kind, key)
        self._gone[kind, key] = self.version
        if len(self._gone) > self._gone_max:
            oldest, self._floor = self._gone.popitem(last=False)
            del self._changed[oldest]
        return True

    def _note(self, kind: str, key: str) -> None:
        self.version += 1
        self._changed[kind, key] = self.version
        self._changed.move_to_end((kind, key))

    def get(self, kind: str, key: str) -> Document | None:
        """The document of an item; None when there is none."""
        item = self._items[kind].get(key)
        return None if item is None else item.document

    def documents(self, kind: str) -> Mapping[str, Document]:
        """The documents of a kind by key, as a copy."""
        return {key: item.document for key, item in self._items[kind].items()}

    def count(self, kind: str) -> int:
        """How many items of a kind there are."""
        return len(self._items[kind])

    def whole(self) -> TableChange:
        """All items."""
        items = {kind: {key: item.text for key, item in items.items()} for kind, items in self._items.items() if items}
        return TableChange(self.version, items)

    def since(self, version: int) -> TableChange | None:
        """What changed after `version`; None when that cannot be told: it is too old, or was never reached."""
        if not self._floor <= version <= self.version:
            return None
        items: dict[str, dict[str, str]] = {}
        gone: dict[str, list[str]] = {}
        for kind, key in self._after(version):
            item = self._items[kind].get(key)
            if item is None:
                gone.setdefault(kind, []).append(key)
            else:
                items.setdefault(kind, {})[key] = item.text
        return TableChange(self.version, items, {kind: tuple(keys) for kind, keys in gone.items()})

    def _after(self, version: int) -> Iterator[tuple[str, str]]:
        for name, changed in reversed(self._changed.items()):
            if changed <= version:
                return
            yield name


def readable(document: Document) -> tuple[Document, str]:
    """A document and its JSON text, as every reader takes them. Numbers that JSON does not have are null, and half
    characters a mark in their place: one agent's document must not keep anybody from reading the others."""
    try:
        text = _text(document)
    except ValueError:
        document = _cleaned(document)
        text = _text(document)
    return document, text


def _text(document: Document) -> str:
    text = json.dumps(document, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    text.encode()
    return text


def _cleaned(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {_cleaned(str(key)): _cleaned(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_cleaned(inner) for inner in value]
    if isinstance(value, str):
        return value.encode(errors="replace").decode()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def resume_id(epoch: str, version: int) -> str:
    """What a reader hands back to be told what came later."""
    return f"{epoch}.{version}"


def resumed_version(text: str, epoch: str) -> int | None:
    """The version in such an id; None when it is of another epoch, or none at all."""
    named, _, version = text.partition(".")
    return int(version) if named == epoch and version.isascii() and version.isdecimal() and len(version) < 16 else None
