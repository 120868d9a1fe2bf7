"""How an expression of a policy looks a word up: in literals that stand in the policy, or in a ConfigMap beside it.

A list that stands in one expression becomes a set when the policy is compiled, so a lookup costs the same for 10 and
for 1,000 digests. An expression has at most 100,000 characters (cel-go), so longer lists are asked in turn.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

CHUNK = 1000  # words of at most 90 characters

Variable = dict[str, str]
"""`name` and `expression`, as a policy's spec.variables has them."""


class Lookup(Protocol):
    """One list, whatever holds it: `parameters` is the ConfigMap that does, empty when the policy itself does."""

    @property
    def parameters(self) -> str:
        """Name of the ConfigMap."""

    def without(self, name: str, candidates: str, image: bool) -> Sequence[Variable]:
        """Variables of which the last is called `name`: those of the variable `candidates` that are not listed.
        `image`: candidates are image references, of which the digest is looked up; otherwise the words themselves."""


@dataclass(frozen=True)
class Literals:
    """Words in the expression itself."""

    words: tuple[str, ...]
    parameters: str = ""

    def without(self, name: str, candidates: str, image: bool) -> Sequence[Variable]:
        """See Lookup."""
        chunks = [self.words[start : start + CHUNK] for start in range(0, len(self.words), CHUNK)] or [()]
        variables: list[Variable] = []
        for number, chunk in enumerate(chunks):
            last = number == len(chunks) - 1
            contained = f"{_digest('c')} in {texts(chunk)}" if image else f"c in {texts(chunk)}"
            condition = f"c.indexOf('@') > 0 && {contained}" if image else contained
            target = name if last else f"{name}{number}"
            variables.append({"name": target, "expression": f"variables.{candidates}.filter(c, !({condition}))"})
            candidates = target
        return variables


@dataclass(frozen=True)
class Parameters:
    """Words as keys of a ConfigMap: `<prefix>.<hex>` for an image, `<prefix>.<name>.<hex>` for a chart. A key holds
    neither `@` nor `:`, so nothing but a digest can be one."""

    parameters: str
    prefix: str

    def without(self, name: str, candidates: str, image: bool) -> Sequence[Variable]:
        """See Lookup."""
        word = f"c.substring(c.indexOf('{AT}') + {len(AT)})" if image else f"c.replace('{AT}', '.')"
        condition = f"c.indexOf('{AT}') > 0 && ('{self.prefix}.' + {word}) in params.?data.orValue({{}})"
        return [{"name": name, "expression": f"variables.{candidates}.filter(c, !({condition}))"}]


AT = "@sha256:"
PARAMETER_KEY = re.compile(r"(?P<prefix>[a-z]+)(\.(?P<chart>.+))?\.(?P<hex>[0-9a-f]{64})")


def parameter_keys(prefix: str, words: Iterable[str]) -> dict[str, str]:
    """Entries of the ConfigMap for digests, or for charts as `<name>@<digest>`."""
    return {f"{prefix}.{word.replace(AT, '.').removeprefix('sha256:')}": "" for word in words}


def parameter_words(prefix: str, keys: Iterable[str]) -> tuple[str, ...]:
    """The words of which `parameter_keys` made these keys; what it did not make is left out."""
    matches = (PARAMETER_KEY.fullmatch(key) for key in keys)
    parts = [(key["chart"] or "", key["hex"]) for key in matches if key and key["prefix"] == prefix]
    return tuple(sorted(f"{chart}{AT}{digest}" if chart else f"sha256:{digest}" for chart, digest in parts))


def texts(words: Iterable[str]) -> str:
    """A list of texts as an expression; words hold neither quotes nor backslashes (their patterns see to that)."""
    return "[" + ",".join(f"'{word}'" for word in words) + "]"


def _digest(reference: str) -> str:
    return f"{reference}.substring({reference}.indexOf('@') + 1)"
