"""policies/merge.yaml: what the gate merges by itself, what waits for a person's approval.

    automatic: [{author: <manager>, paths: [<prefix>]}]     merged as soon as the checks hold
    person: [{paths: [<prefix>]}]                           merged when another person with write rights approved it

A prefix that ends with a slash is a folder, any other is one file. A manager's plan goes the first of these ways that
covers all its files; what people propose never goes the first one. What no way covers is not merged. This file itself
is always open to another person's approval, so no policy locks people out. Always read from main.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

from robotkube.foundation.documents.core.patterns import PATH_PREFIX, WORD
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import read_mapping

PATH = "policies/merge.yaml"
ENTRIES_MAX = 50
AUTOMATIC: Final = "automatic"
APPROVAL: Final = "approval"
CLOSED: Final = "closed"

Way = Literal["automatic", "approval", "closed"]


@dataclass(frozen=True)
class MergePolicy:
    """The content of policies/merge.yaml: `automatic` is account -> prefixes, `person` the prefixes that an approval
    opens."""

    automatic: Mapping[str, tuple[str, ...]]
    person: tuple[str, ...]

    def way_of_plan(self, manager: str, paths: Iterable[str]) -> Way:
        """The way in which a plan of `manager` that touches `paths` is merged."""
        touched = list(paths)
        if _cover(self.automatic.get(manager, ()), touched):
            return AUTOMATIC
        return APPROVAL if _cover(self.person, touched) else CLOSED

    def way_of_person(self, paths: Iterable[str]) -> Way:
        """The way in which a person's pull request that touches `paths` is merged: never without somebody else."""
        return APPROVAL if _cover((*self.person, PATH), list(paths)) else CLOSED


def _cover(prefixes: Sequence[str], paths: Sequence[str]) -> bool:
    """Return whether each path is one of the prefixes, or below one that is a folder."""
    folders = tuple(prefix for prefix in prefixes if prefix.endswith("/"))
    return all(path in prefixes or path.startswith(folders) for path in paths)


def read_merge_policy(text: str, path: str = PATH) -> MergePolicy:
    """The policy in `text`; DocumentError lists every problem."""
    reader = Reader(path)
    document = reader.mapping(read_mapping(text, path), "", [], ["automatic", "person"])
    automatic: dict[str, tuple[str, ...]] = {}
    for where, item in _entries(reader, document, "automatic"):
        entry = reader.mapping(item, where, ["author", "paths"])
        author = reader.word(entry.get("author"), f"{where}.author", WORD)
        automatic[author] = automatic.get(author, ()) + _paths(reader, entry, where)
    person: tuple[str, ...] = ()
    for where, item in _entries(reader, document, "person"):
        person += _paths(reader, reader.mapping(item, where, ["paths"]), where)
    reader.finish()
    return MergePolicy(automatic, person)


def _entries(reader: Reader, document: Mapping[str, Any], key: str) -> Iterable[tuple[str, Any]]:
    """The entries of one key, each with its path; only the first ENTRIES_MAX of a longer list, which is refused."""
    entries = reader.sequence(document.get(key), key)
    if len(entries) > ENTRIES_MAX:
        reader.problems.append(f"{key}: {len(entries)} entries, at most {ENTRIES_MAX} are allowed")
    return [(f"{key}[{index}]", entry) for index, entry in enumerate(entries[:ENTRIES_MAX])]


def _paths(reader: Reader, entry: Mapping[str, Any], where: str) -> tuple[str, ...]:
    prefixes = reader.sequence(entry.get("paths"), f"{where}.paths")
    return tuple(reader.text(prefix, f"{where}.paths", PATH_PREFIX) for prefix in prefixes)
