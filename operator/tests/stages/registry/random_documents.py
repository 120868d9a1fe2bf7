"""Random documents of a catalogue, made from good ones: truncated, huge, of wrong types, deeply nested, not UTF-8.

A case is known by its number: the same number gives the same bytes.
"""

from __future__ import annotations

import copy
import json
import random
from collections.abc import Callable, Mapping
from typing import Any

import yaml

Bytes = Callable[[random.Random, str], bytes]

WRONG: tuple[Any, ...] = (
    None, True, -1, 0, 2**63, 10**400, 1e308, "", "x" * 5000, "{{", "{{ a.b.c }}", "{{ 9 ** 9 ** 9 }}",
    "\u2028", [], {}, [[[[]]]], {"$ref": "#"}, {"$ref": "#/properties/x"}, {"$ref": "http://192.0.2.1/x"},
    {"pattern": "("}, {"forEach": {"v": "x"}, "each": [1]}, {"forEach": 1, "each": 2}, {"type": ["string", 3]},
    {"$schema": ["x"]}, {"enum": 5}, "=1.0.0 " * 900, {"allOf": [{"anyOf": [{"oneOf": [True, False, {}]}]}]},
    ["{{ parameters }}"] * 300,
)  # fmt: skip


def truncated(rng: random.Random, text: str) -> bytes:
    """The beginning only."""
    return text.encode()[: rng.randrange(len(text))]


def damaged(rng: random.Random, text: str) -> bytes:
    """Some bytes are others, most of them no UTF-8."""
    data = bytearray(text.encode())
    for _ in range(rng.choice((1, 3, 30))):
        data[rng.randrange(len(data))] = rng.randrange(256)
    return bytes(data)


def shuffled(rng: random.Random, text: str) -> bytes:
    """Lines in another order or twice."""
    lines = text.splitlines(keepends=True)
    for _ in range(rng.choice((1, 5))):
        lines.insert(rng.randrange(len(lines)), lines[rng.randrange(len(lines))])
    if rng.random() < 0.3:
        rng.shuffle(lines)
    return "".join(lines).encode()


def nested(rng: random.Random, text: str) -> bytes:
    """Something deep: flow or block collections, keys of keys."""
    depth = rng.choice((20, 40, 1000, 100_000))
    deep = rng.choice(("[" * depth, "{a: " * depth, "- " * depth, "? " * depth, "[" * depth + "]" * depth, "(" * depth))
    return f"{text}\n  deep: {deep}\n".encode()


def huge(rng: random.Random, text: str) -> bytes:
    """Much of something."""
    piece = rng.choice((text, "#" * 200 + "\n", "  - x\n", "  a" * 70 + ": 1\n", "'", '"' + "x" * 1000))
    return (text + piece * (rng.choice((50_000, 255_000, 400_000)) // len(piece))).encode()


def aliased(rng: random.Random, text: str) -> bytes:
    """Anchors, aliases, tags, several documents."""
    bombs = (
        "a: &a [x]\nb: &b [*a, *a]\nc: &c [*b, *b]\n",
        "a: &a [*a]\n",
        "a: !!python/name:os.system x\n",
        "a: !!int x\n",
    )
    more = (
        "<<: {a: 1}\n",
        "--- \n",
        "%YAML 9.9\n",
        "a: 0x_\n",
        f"a: {'9' * 5000}\n",
        "\ufeff",
        "a: !!timestamp 1-1-1\n",
    )
    return (rng.choice(bombs + more) + text).encode()


def mistyped(rng: random.Random, text: str) -> bytes:
    """Values at random places are others, keys are missing or new."""
    document = yaml.safe_load(text)
    for _ in range(rng.choice((1, 1, 2, 6))):
        _change(rng, document)
    return json.dumps(document).encode()


def _change(rng: random.Random, document: Any) -> None:
    place = document
    while True:
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        if not keys:
            return
        key = rng.choice(keys)
        if isinstance(place[key], (dict, list)) and place[key] and rng.random() < 0.8:
            place = place[key]
            continue
        choice = rng.random()
        if choice < 0.15:
            del place[key]
        elif choice < 0.25 and isinstance(place, dict):
            place[rng.choice(("x", "forEach", "each", "$ref", ""))] = copy.deepcopy(rng.choice(WRONG))
        else:
            place[key] = copy.deepcopy(rng.choice(WRONG))
        return


WAYS: tuple[Bytes, ...] = (truncated, damaged, shuffled, nested, huge, aliased, mistyped, mistyped, mistyped, mistyped)


def random_document(number: int, files: Mapping[str, str]) -> tuple[str, bytes]:
    """A path among `files` and what stands there in case `number`."""
    rng = random.Random(number)  # noqa: S311  # the same cases every time
    path = rng.choice(sorted(files))
    return path, WAYS[number % len(WAYS)](rng, files[path])
