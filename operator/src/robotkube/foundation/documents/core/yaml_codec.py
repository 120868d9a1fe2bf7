"""YAML text <-> plain values, strictly: the only module of the domain with a library (PyYAML, which here does no I/O).

Reading refuses what different YAML readers understand differently or what can grow without bound: several documents,
duplicate keys, anchors and aliases, tags, keys that are not text, numbers that JSON has not, text beyond a size.
Writing sorts keys, never wraps lines, and quotes every text that any YAML 1.1 or 1.2 reader could read as a number,
so that a hexadecimal identifier such as `12e34567` stays text in Go as well.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import yaml

from robotkube.errors import DocumentError

TEXT_BYTES_MAX = 256 * 1024
DEPTH_MAX = 32
KEY_CHARACTERS_MAX = 100  # beyond, YAML writes keys in another form
SCALARS_CACHED_MAX = 8192
INTEGER_MAX = 2**53  # the ApplicationSet controller reads numbers as doubles

_PLAIN = re.compile(r"[A-Za-z_/][A-Za-z0-9_./@-]*( [A-Za-z0-9_./@-]+)*", re.ASCII)
_PRINTABLE = re.compile(r"[ -~]{0,100000}", re.ASCII)
_HALF_CHARACTER = re.compile("[\ud800-\udfff]")
_YAML_1_1_WORDS = frozenset(["y", "n", "yes", "no", "on", "off", "true", "false", "null"])


SAFE_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""PyYAML's safe loader: the one in C where it was built in, with the same rules and ten times faster."""


class _Loader(SAFE_LOADER):  # type: ignore[misc]
    """Safe loader without timestamps: a time stays the text that was written."""


_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag != "tag:yaml.org,2002:timestamp"]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}


def _mapping(loader: _Loader, node: yaml.MappingNode) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for key_node, value_node in node.value:
        key = loader.construct_object(key_node, deep=True)
        line = key_node.start_mark.line + 1
        if not isinstance(key, str):
            raise yaml.YAMLError(f"line {line}: key {key!r} is not text; put it in quotes")
        if key in result:
            raise yaml.YAMLError(f"line {line}: key {key!r} stands twice; keep one of them")
        result[key] = loader.construct_object(value_node, deep=True)
    return result


_Loader.add_constructor("tag:yaml.org,2002:map", _mapping)


class _Dumper(yaml.SafeDumper):
    """Block style; texts that are not plainly text are quoted."""

    def ignore_aliases(self, data: Any) -> bool:
        """Never write anchors: the reader refuses them."""
        return True


def _text(dumper: _Dumper, value: str) -> yaml.ScalarNode:
    plain = _PLAIN.fullmatch(value) and value.lower() not in _YAML_1_1_WORDS
    return dumper.represent_scalar("tag:yaml.org,2002:str", value, style=None if plain else '"')


_Dumper.add_representer(str, _text)


def read_mapping(text: str, where: str, values: bool = True) -> dict[str, Any]:
    """The one mapping in `text`; DocumentError names `where` and the problem when it is anything else. Without `values`
    numbers that JSON has not are let through, for who asks `json_problems` himself, to name them with the rest."""
    documents = _read(text, where, TEXT_BYTES_MAX)
    if len(documents) != 1 or not isinstance(documents[0], dict):
        raise DocumentError(where, ["must hold exactly one YAML document, a mapping"])
    if values:
        _refuse_values(documents, where)
    return documents[0]


def read_mappings(text: str, where: str, bytes_max: int) -> list[dict[str, Any]]:
    """Every mapping in `text`, one per document, empty documents left out; DocumentError as for one."""
    documents = [document for document in _read(text, where, bytes_max) if document is not None]
    if not all(isinstance(document, dict) for document in documents):
        raise DocumentError(where, ["every YAML document must be a mapping"])
    _refuse_values(documents, where)
    return documents


def _read(text: str, where: str, bytes_max: int) -> list[Any]:
    if len(text.encode()) > bytes_max:
        raise DocumentError(where, [f"longer than {bytes_max} bytes; split it"])
    try:
        _refuse_structure(text, where)
        return list(yaml.load_all(text, Loader=_Loader))
    except (yaml.YAMLError, ValueError) as error:  # a number that is none, or with thousands of digits
        message = " ".join(str(error).split())
        raise DocumentError(where, [f"not readable as YAML: {message}{_tab_hint(text, error)}"]) from error


def _tab_hint(text: str, error: Exception) -> str:
    mark = getattr(error, "problem_mark", None)
    lines = text.splitlines()
    at = lines[mark.line][mark.column : mark.column + 1] if mark and mark.line < len(lines) else ""
    return "; there is a tab: indent with spaces" if at == "\t" else ""


def _refuse_values(documents: Sequence[Any], where: str) -> None:
    problems = [problem for document in documents for problem in json_problems(document, "")]
    if problems:
        raise DocumentError(where, problems)


def _refuse_structure(text: str, where: str) -> None:
    """Refuse by events, before anything is built: building recurses, and aliases grow."""
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.NodeEvent):
            _refuse_node(event, where)
            depth += isinstance(event, yaml.CollectionStartEvent)
            if depth > DEPTH_MAX + 1:
                raise DocumentError(where, [f"nested deeper than {DEPTH_MAX}; write it flatter"])
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1


def _refuse_node(event: Any, where: str) -> None:
    """Refuse what is no plain value: an anchor, an alias, which is one to an anchor, or a tag."""
    if event.anchor:
        line = event.start_mark.line + 1 if event.start_mark else 0
        raise DocumentError(where, [f"line {line}: anchors and aliases are not allowed; write the value out"])
    if event.tag:
        line = event.start_mark.line + 1 if event.start_mark else 0
        raise DocumentError(where, [f"line {line}: tag {event.tag!r:.60} is not allowed; write a plain value"])


def write_mapping(document: Mapping[str, Any]) -> str:
    """`document` as YAML text: keys sorted, no wrapped lines, one trailing newline."""
    try:
        lines: list[str] = []
        _write_mapping(document, "", "", lines)
        return "\n".join([*lines, ""]) if lines else "{}\n"
    except _UnusualError:
        return write_with_library(document)


def write_with_library(document: Mapping[str, Any]) -> str:
    """The same by PyYAML, for every document; what is written above is that, character by character, but faster."""
    return yaml.dump(
        document, Dumper=_Dumper, sort_keys=True, allow_unicode=True, width=2**20, default_flow_style=False
    )


class _UnusualError(Exception):
    """A value whose writing is left to the library."""


def _write_mapping(mapping: Mapping[str, Any], first: str, rest: str, lines: list[str]) -> None:
    """`first` stands before the first line, `rest` before the others."""
    for key in sorted(mapping):
        item = mapping[key]
        start = f"{first}{_key(key)}:"
        if isinstance(item, dict) and item:
            lines.append(start)
            _write_mapping(item, f"{rest}  ", f"{rest}  ", lines)
        elif isinstance(item, (list, tuple)) and item:
            lines.append(start)
            _write_sequence(item, rest, rest, lines)
        else:
            lines.append(f"{start} {_scalar(item)}")
        first = rest


def _write_sequence(sequence: Sequence[Any], first: str, rest: str, lines: list[str]) -> None:
    for item in sequence:
        if isinstance(item, dict) and item:
            _write_mapping(item, f"{first}- ", f"{rest}  ", lines)
        elif isinstance(item, (list, tuple)) and item:
            _write_sequence(item, f"{first}- ", f"{rest}  ", lines)
        else:
            lines.append(f"{first}- {_scalar(item)}")
        first = rest


def _key(key: Any) -> str:
    if not isinstance(key, str) or not 0 < len(key) <= KEY_CHARACTERS_MAX:
        raise _UnusualError
    return _quoted(key)


def _scalar(value: Any) -> str:
    if isinstance(value, str):
        return _quoted(value)
    if value is None or isinstance(value, bool):
        return "null" if value is None else "true" if value else "false"
    if type(value) is int:
        return str(value)
    if isinstance(value, (dict, list, tuple)):  # empty
        return "{}" if isinstance(value, dict) else "[]"
    raise _UnusualError


@lru_cache(SCALARS_CACHED_MAX)
def _quoted(text: str) -> str:
    if _PLAIN.fullmatch(text) and text.lower() not in _YAML_1_1_WORDS:
        return text
    if not _PRINTABLE.fullmatch(text):
        raise _UnusualError
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def json_problems(value: Any, path: str, depth: int = 0) -> list[str]:
    """The parts of `value` that JSON and a Go reader would not carry unchanged; `path` is the key so far
    (`spec.values.x`)."""
    if depth > DEPTH_MAX:
        return [f"{path}: nested deeper than {DEPTH_MAX}"]
    if value is None or isinstance(value, bool):
        return []
    if isinstance(value, str):
        broken = not value.isascii() and _HALF_CHARACTER.search(value)
        return [f"{path}: text with half a character (a lone surrogate), which UTF-8 has not"] if broken else []
    if isinstance(value, int):
        too_large = abs(value) > INTEGER_MAX
        return [f"{path}: {value} is beyond 2^53 and would lose digits; write it as text"] if too_large else []
    if isinstance(value, float):
        return [] if math.isfinite(value) else [f"{path}: {value} is not a JSON number"]
    if isinstance(value, Mapping):
        problems = [f"{path}: key {key!r} is not text" for key in value if not isinstance(key, str)]
        return problems + [
            problem for key, item in value.items() for problem in json_problems(item, join(path, str(key)), depth + 1)
        ]
    if isinstance(value, Sequence) and not isinstance(value, (bytes, bytearray)):
        return [
            problem
            for index, item in enumerate(value)
            for problem in json_problems(item, f"{path}[{index}]", depth + 1)
        ]
    return [f"{path}: {type(value).__name__} is not a JSON value"]


def join(path: str, key: str) -> str:
    """`path` extended by `key`, joined by a dot."""
    return f"{path}.{key}" if path else key
