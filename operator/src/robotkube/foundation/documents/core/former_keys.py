"""Former keys of documents that people write: what stands under one is read under the key of today.

A document has a key under one of its names. Under both it is refused, whichever of them is empty: nobody could say
which one was meant.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.foundation.documents.core.yaml_codec import join


def _unchanged(value: Any) -> Any:
    return value


@dataclass(frozen=True)
class FormerKey:
    """A key that has another name now, in the same mapping of the document: `within` is that mapping's path, empty at
    the top. `convert` makes today's form of a value of the former one."""

    key: str
    new_key: str
    within: str = ""
    convert: Callable[[Any], Any] = _unchanged

    @property
    def path(self) -> str:
        """The former key with the path of its mapping."""
        return join(self.within, self.key)

    @property
    def new_path(self) -> str:
        """Today's key with the path of its mapping."""
        return join(self.within, self.new_key)


@dataclass(frozen=True)
class RenamedDocument:
    """A document with keys of today only, the former keys that it was written with, and what is wrong with them."""

    document: Mapping[str, Any]
    written: tuple[FormerKey, ...]
    problems: tuple[str, ...]

    def as_written(self, problem: str) -> str:
        """A problem of a reader, which knows keys of today, with the key that stands in the document."""
        for former in self.written:
            if problem.startswith(tuple(f"{former.new_path}{end}" for end in ":.[")):
                rest = problem.removeprefix(former.new_path)
                return f"{former.path}{rest} ({former.path} is the former name of {former.new_path})"
        return problem


def under_new_keys(document: Mapping[str, Any], former_keys: Iterable[FormerKey]) -> RenamedDocument:
    """The document with the values of its former keys under the keys of today."""
    written, problems = list[FormerKey](), list[str]()
    for former in former_keys:
        mapping = _mapping_at(document, former.within)
        if former.key not in mapping:
            continue
        if former.new_key not in mapping or mapping[former.new_key] is None:
            written.append(former)
        if former.new_key in mapping:
            problems.append(_both(former, mapping))
        document = _with_mapping(document, former.within, _renamed(mapping, former))
    return RenamedDocument(document, tuple(written), tuple(problems))


def _both(former: FormerKey, mapping: Mapping[str, Any]) -> str:
    """What to do about a key that stands under both names: the value that is there is kept."""
    there = f"{former.path}: is the former name of {former.new_path}, which is there as well"
    if mapping[former.new_key] is None and mapping[former.key] is not None:
        return f"{there}, without a value; give it what {former.path} has and remove {former.path}"
    return f"{there}; remove {former.path}"


def _renamed(mapping: Mapping[str, Any], former: FormerKey) -> Mapping[str, Any]:
    values = {key: value for key, value in mapping.items() if key != former.key}
    if values.get(former.new_key) is None:
        values[former.new_key] = former.convert(mapping[former.key])
    return values


def _mapping_at(document: Mapping[str, Any], path: str) -> Mapping[str, Any]:
    """The mapping at a path; empty when there is none, which the reader of the document says."""
    value: Any = document
    for key in path.split(".") if path else ():
        value = value.get(key) if isinstance(value, Mapping) else None
    return value if isinstance(value, Mapping) else {}


def _with_mapping(document: Mapping[str, Any], path: str, mapping: Mapping[str, Any]) -> Mapping[str, Any]:
    if not path:
        return mapping
    key, _, rest = path.partition(".")
    return {**document, key: _with_mapping(document[key], rest, mapping)}
