"""The sources of a catalogue as they were read from folders, and the problems in them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.foundation.documents.core.wrong_keys import without_consequences
from robotkube.registry.charts.core.values_schemas import Validate

TEXT_CHARACTERS_MAX = 600

Path = tuple[str | int, ...]


@dataclass(frozen=True, order=True)
class SourceProblem:
    """One mistake: the file (as the user named its folder), the key in it, what is wrong and how to repair it."""

    file: str
    key: str
    text: str

    def __str__(self) -> str:
        return f"{self.file}: {self.key}: {self.text}"


@dataclass(frozen=True)
class ChartFolder:
    """A chart next to the registry. `path` is its folder as the user named it, `images` what Chart.yaml says it runs
    (None when it does not say), `schema` values.schema.json (None when there is none). `interfaces` and `entry_images`
    are those of its entry, where that is known."""

    path: str
    name: str
    version: str
    images: tuple[str, ...] | None = None
    values: Mapping[str, Any] = field(default_factory=dict)
    schema: Mapping[str, Any] | None = None
    interfaces: Sequence[Mapping[str, Any]] = ()
    entry_images: Sequence[str] = ()


@dataclass(frozen=True)
class CatalogueSources:
    """The sources of the catalogue: `files` are those of the registry (path inside it -> text), `root` its folder as
    the user named it, `folders` charts by name, `findings` what could not be read."""

    root: str
    files: Mapping[str, str]
    folders: Mapping[str, ChartFolder] = field(default_factory=dict)
    findings: tuple[SourceProblem, ...] = ()

    def finding(self, path: str, key: str, text: str) -> SourceProblem:
        """A mistake in one of `files`."""
        shown = text if len(text) <= TEXT_CHARACTERS_MAX else text[: TEXT_CHARACTERS_MAX - 1] + "…"
        return SourceProblem(f"{self.root}/{path}", key, " ".join(shown.split()))


@dataclass(frozen=True)
class Tools:
    """The libraries that validation needs: `render` fills templates, `references` names what a template refers to
    (`("parameters", "vehicles")`, `("agent",)`), `check_schema` what is wrong with a JSON Schema, `validate` what is
    wrong with a value under one, `violations` the same with the path in the value."""

    render: Render
    references: Callable[[str], frozenset[tuple[str, ...]]]
    check_schema: Callable[[Mapping[str, Any]], Sequence[str]]
    validate: Validate
    violations: Callable[[Mapping[str, Any], Any], Sequence[tuple[Path, str]]]


def findings_of(sources: CatalogueSources, path: str, error: DocumentError) -> list[SourceProblem]:
    """The problems of one unreadable file; each begins with its key, or concerns the whole document."""
    findings = []
    for problem in without_consequences(error.problems):
        key, separator, text = problem.partition(": ")
        if not separator or " " in key:
            key = "document"
            text = problem
        if key == "path":
            text = _misplaced(sources, path, text)
        fix = "" if ";" in text else "; write it" if text == "missing" else f"; {_FIX}"
        findings.append(sources.finding(path, key or repr(key), text + fix))
    return findings


def _misplaced(sources: CatalogueSources, path: str, text: str) -> str:
    """A file whose name is not that of what it holds."""
    right = next((other for other in sources.files if text.endswith(f" must be {other!r}")), "")
    if right:
        return f"{path} holds the same as {right} by name and version; keep one of them"
    return f"{text}; rename the file or correct the name and version in it"


_FIX = "correct it (docs/reference/schemas.md says what may stand there)"


def dotted(path: str, parts: Path) -> str:
    """`path` extended by the keys and indices of `parts`."""
    return path + "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts)
