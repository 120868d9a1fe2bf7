"""The values: merged as Helm merges them, and what chart and schema refuse of them. No value is repeated in words."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.preflight.core.findings import CheckVerdict, Problem, without_accounts
from robotkube.delivery.preflight.core.renderings import agents

NUMBERED = re.compile(r"^\s*[0-9]+\. (.+)$", re.MULTILINE)
WHY_REFUSED = "Helm installs and upgrades nothing while the chart refuses the values"
KEYS = "charts/robotkube/README.md lists the keys"
Path = Sequence[str | int]


@dataclass(frozen=True)
class Judgement:
    """What the schema and the chart's own rules refuse of the values: places with words, and the text of the latter;
    `source` is where the values come from."""

    violations: Sequence[tuple[Path, str]]
    refusal: str
    source: str


def merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Two mappings as Helm merges values: mappings key by key, anything else is replaced."""
    result = dict(below)
    for key, value in above.items():
        under = result.get(key)
        both = isinstance(value, Mapping) and isinstance(under, Mapping)
        result[key] = merged(under, value) if both and under is not None else value
    return result


def completed(defaults: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """The values that templates see: the chart's defaults under those that were given; null takes a default away."""
    result = dict(defaults)
    for key, value in given.items():
        under = defaults.get(key)
        if value is None and key in defaults:
            del result[key]
        elif isinstance(value, Mapping) and isinstance(under, Mapping):
            result[key] = completed(under, value)
        else:
            result[key] = value
    return result


def without_value(message: str, settings: Any, path: Path) -> str:
    """A message of the schema without the value that it is about, which may be secret."""
    value = settings
    for step in path:
        value = value[step]  # the schema found it there
    return message.replace(repr(value), "this value", 1)


def values(judgement: Judgement, settings: Mapping[str, Any]) -> CheckVerdict:
    """Schema and templates of the chart take the values."""
    says = f"values of {judgement.source}; {len(agents(settings))} agents"
    if judgement.violations:
        return CheckVerdict(says, [_violation(path, words) for path, words in judgement.violations])
    return CheckVerdict(says, list(_refusals(judgement.refusal)))


def _violation(path: Path, words: str) -> Problem:
    return Problem(words, f"values, {_written(path)}", WHY_REFUSED, f"correct or remove the key; {KEYS}")


def _written(path: Path) -> str:
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path)
    return text.removeprefix(".") or "top"


def _refusals(text: str) -> Iterator[Problem]:
    hidden = without_accounts(text)
    for sentence in NUMBERED.findall(hidden) or ([hidden] if hidden else []):
        what, separator, fix = str(sentence).partition(". ")
        yield Problem(what, "values", WHY_REFUSED, fix if separator else f"correct the values; {KEYS}")
