"""Random messages for the task gateway: good ones, damaged, huge, deep, of wrong types, full of strange characters.

A message is known by its number: the same number gives the same bytes.
"""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from typing import Any

SPEC = {"application": "pose-point-cloud-recording", "parameters": {"vehicles": ["vehicle-00", "vehicle-01"]}}
ASKED = {"metadata": {"name": "look"}, "spec": SPEC}


def random_message(number: int) -> bytes:
    """A message known by its number: good, damaged, huge, deep, of wrong types, full of strange characters."""
    rng = random.Random(number)  # noqa: S311 - for tests
    wrong: list[Any] = [
        None,
        True,
        -1,
        2**70,
        1e308,
        "",
        "\u2028\ud800",
        "\x00",
        [],
        {},
        [[[[]]]],
        "x" * 5000,
        "Ж" * 300,
    ]
    document: dict[str, Any] = json.loads(json.dumps(ASKED))
    places: list[Callable[[], Any]] = [
        lambda: document.update(
            {rng.choice(["metadata", "spec", "kind", "x", "withdraw", "renew"]): rng.choice(wrong)}
        ),
        lambda: document["spec"].update({rng.choice(list(SPEC)): rng.choice(wrong)}),
        lambda: document["spec"]["parameters"].update({"\U0001f697" * rng.randrange(1, 9): rng.choice(wrong)}),
        lambda: document["metadata"].update(name=rng.choice([*wrong, "a-b", "a" * 300, "../x", "vehicle-01/x"])),
        lambda: None,
    ]
    rng.choice(places)()
    data = json.dumps(document, ensure_ascii=rng.random() < 0.5).encode(errors="surrogatepass")
    kind = rng.randrange(8)
    if kind == 0:
        return data[: rng.randrange(len(data))]
    if kind == 1:
        return bytes(rng.randrange(256) for _ in range(rng.choice((1, 50, 3000))))
    if kind == 2:
        return data.replace(b'"vehicles"', b'"v": ' + b'{"a":' * 20_000 + b"1" + b"}" * 20_000 + b', "vehicles"', 1)
    if kind == 3 and number % 5 == 0:
        return data + b" " * (10 * 1024 * 1024)
    return data
