"""The parts that every kind of catalogue entry has: its head, and forEach over one variable."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from robotkube.foundation.documents.core.patterns import NAME, VARIABLE
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import read_mapping

API = "registry.robotkube.io/v1alpha1"
DESCRIPTION_CHARACTERS_MAX = 1000


def read_head(reader: Reader, text: str, kind: str, parts: Iterable[str] = ()) -> tuple[Mapping[str, Any], str]:
    """The document in `text` and metadata.name; `parts` are optional keys besides the four that all entries have."""
    required = ["apiVersion", "kind", "metadata", "spec"]
    document = reader.mapping(read_mapping(text, reader.where), "", required, parts)
    reader.equal(document.get("apiVersion"), "apiVersion", API)
    reader.equal(document.get("kind"), "kind", kind)
    metadata = reader.mapping(document.get("metadata") or {}, "metadata", ["name"])
    return document, reader.word(metadata.get("name"), "metadata.name", NAME)


def read_description(reader: Reader, value: Any, path: str) -> str:
    """A description: a text that is not empty."""
    text = reader.prose(value, path)
    if isinstance(value, str) and not 0 < len(text) <= DESCRIPTION_CHARACTERS_MAX:
        reader.problems.append(f"{path}: must have 1 to {DESCRIPTION_CHARACTERS_MAX} characters")
    return text


def read_for_each(reader: Reader, value: Any, path: str, reserved: frozenset[str]) -> Mapping[str, Any]:
    """One variable and its list (or a template that gives one); nothing when `value` is None."""
    for_each = value if value is not None else {}
    if not isinstance(for_each, Mapping) or len(for_each) > 1:
        reader.problems.append(f"{path}: must be one variable and its list")
        return {}
    for variable, values in for_each.items():
        reader.text(variable, path, VARIABLE)
        if variable in reserved:
            reader.problems.append(f"{path}: the name {variable!r} is taken; choose another")
        if not isinstance(values, (list, str)):
            reader.problems.append(f"{path}.{variable}: must be a list or a template that gives one")
    return for_each
