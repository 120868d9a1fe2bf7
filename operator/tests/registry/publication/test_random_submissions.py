"""Random texts in a submission: always a refusal in words, never another error."""

import random

import pytest

from robotkube.registry.publication.adapters.submission_folders import validation_tools
from robotkube.registry.publication.core.submissions import Proposed, read_submission
from tests.stages.registry.submissions import CATALOGUE, application, chart, entry, entry_path

PACKED, SPEC = chart()
PATH = entry_path(PACKED)
TOOLS = validation_tools()
PIECES = (
    "a: [",
    "{",
    "}",
    "\0",
    "\t",
    "&x ",
    "*x",
    "!!python/object:os.system ",
    "- ",
    "'",
    "🤖",
    "0x1e9",
    "~",
    "\n",
    ": ",
)
VALUES = (
    "[]",
    "{}",
    "null",
    "1e999",
    "-1",
    "true",
    "[[[[[[[[[[[[[[[[[[]]]]]]]]]]]]]]]]]]",
    "'{{ 9**9 }}'",
    "2026-11-21",
    "x" * 5000,
)


def damaged(text: str, chance: random.Random) -> str:
    """`text` with a few mistakes of many kinds."""
    for _ in range(chance.randint(1, 4)):
        lines = text.splitlines() or [""]
        kind, at = chance.randrange(5), chance.randrange(len(lines))
        if kind == 0:
            text = text[: chance.randrange(len(text) + 1)]
        elif kind == 1:
            position = chance.randrange(len(text) + 1)
            text = text[:position] + chance.choice(PIECES) * chance.choice((1, 2, 400)) + text[position:]
        elif kind == 2:
            lines[at] = lines[at].partition(":")[0] + ": " + chance.choice(VALUES)
            text = "\n".join(lines)
        elif kind == 3:
            text = "\n".join(lines[:at] + lines[at:][::-1])
        else:
            text = "\n".join([*lines, *lines[at:]])
    return text


def refused_in_words(seed: int) -> None:
    chance = random.Random(seed)  # noqa: S311 - not a secret
    sources = {
        PATH: entry(PACKED, SPEC),
        "applications/relaying.yaml": application(),
        f"evidence/relay/0.1.0_{PACKED.digest[7:19]}/static.json": '{"payload": ""}',
    }
    changes: dict[str, str | None] = {path: damaged(text, chance) for path, text in sources.items()}
    proposed = Proposed(("a" * 40,), changes, (), True, CATALOGUE, CATALOGUE)
    answer = read_submission(proposed, chance.random() < 0.5, TOOLS)
    assert all(isinstance(problem, str) and problem for problem in answer.problems)
    assert answer.problems or answer.charts


def test_200_random_submissions() -> None:
    for seed in range(200):
        refused_in_words(seed)


@pytest.mark.thorough
def test_1000_random_submissions() -> None:
    for seed in range(1000, 2000):
        refused_in_words(seed)
