"""Names in words of the field: what words.toml lists is no part of the name of a module, class, function or key."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from ci.errors import InputError

FILE = "ci/check/words.toml"
PART = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|[0-9]+")
KEY = re.compile(r"[A-Za-z_]\w*", re.ASCII)  # what is no identifier is a path, a header, a sentence
TESTS = "operator/tests/"


@dataclass(frozen=True)
class Vocabulary:
    """Private words with those of the field, and by file the keys that stay what they were."""

    words: Mapping[str, str]
    former_keys: Mapping[str, Sequence[str]]


def read(text: str) -> Vocabulary:
    """The words of words.toml; InputError names what is wrong with it."""
    try:
        document: dict[str, Any] = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{FILE}: {error}; write it as TOML") from error
    if unknown := sorted(document.keys() - {"words", "former_keys"}):
        raise InputError(f"{FILE}: {unknown[0]}: is unknown; known tables are words and former_keys")
    words = document.get("words", {})
    for word, instead in words.items():
        if not re.fullmatch("[a-z]+", word) or not isinstance(instead, str) or not instead:
            raise InputError(f"{FILE}: words.{word}: must be one word in small letters, with the field's word for it")
    return Vocabulary(words, document.get("former_keys", {}))


def findings(name: str, text: str, vocabulary: Vocabulary) -> list[str]:
    """The names in a module that have a private word. Of a module of tests its own name and its classes count."""
    former = vocabulary.former_keys.get(name, ())
    return [
        f"{name}:{line}: {kind} {given} has the private word {word!r}; the field's is: "
        f"{vocabulary.words[word]} ({FILE})"
        for line, kind, given in _names(name, ast.parse(text))
        if not (kind == "key" and given in former)
        for word in dict.fromkeys(parts(given))
        if word in vocabulary.words
    ]


def unused(vocabulary: Vocabulary, top: Path) -> list[str]:
    """Former keys that no file has any more."""
    return [
        f"{FILE}: former_keys: {name} has no key {key!r}; take it out"
        for name, keys in vocabulary.former_keys.items()
        for key in keys
        if not (top / name).is_file() or f'"{key}"' not in (top / name).read_text(encoding="utf-8")
    ]


def parts(name: str) -> list[str]:
    """The words of a name in small letters: NodeRoom, node_room and nodeRoom are the same two."""
    return [part.lower() for part in PART.findall(name)]


def _names(name: str, tree: ast.Module) -> Iterator[tuple[int, str, str]]:
    """Line, kind and name of all that is named."""
    yield 1, "module", PurePosixPath(name).stem
    tests = name.startswith(TESTS)
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            yield node.lineno, "class", node.name
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not tests:
            yield node.lineno, "function", node.name
        elif isinstance(node, ast.Dict) and not tests:
            yield from _keys(node)


def _keys(node: ast.Dict) -> Iterator[tuple[int, str, str]]:
    for key in node.keys:
        if isinstance(key, ast.Constant) and isinstance(key.value, str) and KEY.fullmatch(key.value):
            yield key.lineno, "key", key.value
