"""policies/merge.yaml: what the gate merges by itself, what waits for a person's approval.

    automatic: [{author: <account>, paths: [<prefix>]}]     merged as soon as the checks hold
    person: [{paths: [<prefix>]}]                           merged when another person with write rights approved it

A prefix that ends with a slash is a folder, any other is one file. A pull request goes the first of these ways that
covers all its files; what neither covers is merged by people in the forge. Always read from main.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

from robotkube.foundation.documents.core.patterns import PATH_PREFIX, WORD
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.foundation.forge.core.reviews import Review

PATH = "policies/merge.yaml"
ENTRIES_MAX = 50
AUTOMATIC: Final = "automatic"
APPROVAL: Final = "approval"
FORGE: Final = "forge"

Way = Literal["automatic", "approval", "forge"]


def is_approved(reviews: Iterable[Review], commit: str, author: str, proposers: Iterable[str]) -> bool:
    """Whether a person other than the author approved exactly `commit`, and nobody who may is against it. The last
    word of each person counts; `reviews` are oldest first."""
    excluded = {author, *proposers}
    last = {r.author: r for r in reviews if r.official and r.commit == commit and r.author not in excluded}
    return bool(last) and all(review.approved for review in last.values())


@dataclass(frozen=True)
class MergePolicy:
    """`automatic` is account -> prefixes, `person` the prefixes that an approval opens."""

    automatic: Mapping[str, tuple[str, ...]]
    person: tuple[str, ...]

    def way(self, author: str, paths: Iterable[str]) -> Way:
        """How a pull request of `author` that touches `paths` becomes main."""
        touched = list(paths)
        if _cover(self.automatic.get(author, ()), touched):
            return AUTOMATIC
        return APPROVAL if _cover(self.person, touched) else FORGE


def _cover(prefixes: Sequence[str], paths: Sequence[str]) -> bool:
    return all(any(path == p or (p.endswith("/") and path.startswith(p)) for p in prefixes) for path in paths)


def read_merge_policy(text: str, path: str = PATH) -> MergePolicy:
    """The policy in `text`; DocumentError lists every problem."""
    reader = Reader(path)
    document = reader.mapping(read_mapping(text, path), "", [], ["automatic", "person"])
    automatic: dict[str, tuple[str, ...]] = {}
    for where, item in _entries(reader, document, "automatic"):
        found = reader.mapping(item, where, ["author", "paths"])
        author = reader.word(found.get("author"), f"{where}.author", WORD)
        automatic[author] = automatic.get(author, ()) + _paths(reader, found, where)
    person: tuple[str, ...] = ()
    for where, item in _entries(reader, document, "person"):
        person += _paths(reader, reader.mapping(item, where, ["paths"]), where)
    reader.finish()
    return MergePolicy(automatic, person)


def _entries(reader: Reader, document: Mapping[str, Any], key: str) -> Iterable[tuple[str, Any]]:
    found = reader.sequence(document.get(key), key)
    if len(found) > ENTRIES_MAX:
        reader.problems.append(f"{key}: {len(found)} entries, at most {ENTRIES_MAX} are allowed")
    return [(f"{key}[{index}]", item) for index, item in enumerate(found[:ENTRIES_MAX])]


def _paths(reader: Reader, found: Mapping[str, Any], where: str) -> tuple[str, ...]:
    listed = reader.sequence(found.get("paths"), f"{where}.paths")
    return tuple(reader.text(path, f"{where}.paths", PATH_PREFIX) for path in listed)
