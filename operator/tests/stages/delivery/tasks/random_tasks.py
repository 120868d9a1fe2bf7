"""Random TaskDescriptions, made from a good one: huge, deep, of wrong types, with unknown fields or strange texts.

A case is known by its number: the same number gives the same document.
"""

from __future__ import annotations

import copy
import random
from collections.abc import Callable, Iterator
from typing import Any

HUGE_CHARACTERS = 10 * 1024 * 1024
TEXTS = (
    "", " ", "\0", "\n", "\ud800", "\u202e", "\U0001f916" * 50, "é" * 300, "../../x", "a/b", "-", "A", "null",
    "x" * 5000, "{{ parameters }}", "{{ 9 ** 9 ** 9 }}", "vehicle-00", "2026-11-21T10:00:00Z", "9999-12-31T23:59:59Z",
    "0001-01-01T00:00:00+23:59", "2026-02-30T00:00:00Z",
)  # fmt: skip
WRONG: tuple[Any, ...] = (
    None, True, False, -1, 0, 1, 5, 2**63, 10**400, 1e308, float("inf"), float("nan"), [], {}, [[]], [None], {"": None},
    {"$ref": "#"}, ["vehicle-00"] * 40, [{}] * 40, {"seconds": "5"}, {"secondsMax": 5, "x": 1}, *TEXTS,
)  # fmt: skip
KEYS = (
    "application", "provides", "requirements", "placement", "priority", "lease", "conflictPolicy", "offloadTo", "queue",
    "chain", "event", "requester", "reason", "parameters", "x", "", "é", "status", "constructor",
)  # fmt: skip


def good() -> dict[str, Any]:
    """A task that the manager accepts."""
    event = {"rule": "near", "id": "event-1", "trace": "a" * 32, "time": "2026-11-21T10:00:00Z"}
    metadata = {"namespace": "cloud-0", "name": "random", "uid": "u", "creationTimestamp": "2026-11-21T10:00:00Z"}
    return {
        "metadata": {**metadata, "generation": 1, "annotations": {"robotkube.io/agents": "vehicle-00 vehicle-01"}},
        "spec": {
            "requester": "cloud-0/event-detector",
            "event": event,
            "reason": "near each other",
            "application": "pose-point-cloud-recording",
            "parameters": {"vehicles": ["vehicle-00", "vehicle-01"]},
            "priority": 50,
            "lease": {"seconds": 60},
            "conflictPolicy": "Postpone",
            "queue": {"secondsMax": 60},
            "placement": {"roles": ["cloud"], "antiAffinity": ["other"]},
            "requirements": [{"guarantee": "latency", "atMost": 50, "unit": "ms"}],
        },
    }


def mistyped(rng: random.Random, spec: dict[str, Any]) -> None:
    """Values at random places are others."""
    for _ in range(rng.choice((1, 1, 2, 6))):
        place, key = rng.choice(list(_places(spec)))
        place[key] = copy.deepcopy(rng.choice(WRONG))


def missing(rng: random.Random, spec: dict[str, Any]) -> None:
    """Some keys are gone."""
    for key in rng.sample(sorted(spec), rng.randint(1, len(spec))):
        del spec[key]


def unknown(rng: random.Random, spec: dict[str, Any]) -> None:
    """Keys that nobody knows, or known ones that do not go together."""
    for _ in range(rng.choice((1, 3, 30))):
        places = [spec, *(value for value in spec.values() if isinstance(value, dict))]
        rng.choice(places)[rng.choice(KEYS)] = copy.deepcopy(rng.choice(WRONG))


def strange(rng: random.Random, spec: dict[str, Any]) -> None:
    """Texts of strange characters."""
    for place, key in list(_places(spec)):
        if isinstance(place[key], str) and rng.random() < 0.5:
            place[key] = "".join(chr(rng.choice((rng.randrange(128), rng.randrange(0x110000)))) for _ in range(20))


def deep(rng: random.Random, spec: dict[str, Any]) -> None:
    """Something nested."""
    value: Any = 0
    for _ in range(rng.choice((5, 31, 33, 150))):
        value = [value] if rng.random() < 0.5 else {"a": value}
    place, key = rng.choice(list(_places(spec)))
    place[key] = value


def huge(rng: random.Random, spec: dict[str, Any]) -> None:
    """Ten megabytes of something."""
    values: tuple[Callable[[], Any], ...] = (
        lambda: "x" * HUGE_CHARACTERS,
        lambda: ["vehicle-00"] * 500_000,
        lambda: {f"key-{number}": number for number in range(200_000)},
        lambda: {"x" * HUGE_CHARACTERS: 1},
        lambda: "é" * (HUGE_CHARACTERS // 2),
    )
    place, key = rng.choice([*_places(spec), (spec, "unknown")])
    place[key] = rng.choice(values)()


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    keys = list(value) if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    for key in keys:
        yield value, key
        yield from _places(value[key])


WAYS = (mistyped, mistyped, mistyped, missing, unknown, unknown, strange, deep)
HUGE_EVERY = 40


def random_task(number: int) -> dict[str, Any]:
    """The document of case `number`: one in HUGE_EVERY is huge, every hundredth is good."""
    rng = random.Random(number)  # noqa: S311  # the same cases every time
    document = good()
    if number % HUGE_EVERY == 0:
        huge(rng, document["spec"])
    elif number % 100 != 1:
        for _ in range(rng.choice((1, 1, 2))):
            if document["spec"]:
                rng.choice(WAYS)(rng, document["spec"])
    if rng.random() < 0.2:
        document["metadata"]["annotations"] = {"robotkube.io/lease-renewed": rng.choice(TEXTS)}
    return document
