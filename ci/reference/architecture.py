"""The picture of packages in docs/explanation/architecture.md, drawn from the imports and the packages' docstrings.

`make reference` writes it between its markers; a test compares.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import grimp

from ci.folders import PROJECT

PAGE = PROJECT / "docs" / "explanation" / "architecture.md"
SOURCE = PROJECT / "operator" / "src"
BEGIN, END = "<!-- packages: make reference writes this -->", "<!-- packages end -->"
FLOORS = ("delivery", "registry", "robots", "foundation")  # from above
TOP = ("cli", "setup", "plugins", "services")
WIDTH = 100


def subjects(floor: str) -> list[str]:
    """Names of the packages on a floor."""
    folder = SOURCE / "robotkube" / floor
    return sorted(path.parent.name for path in folder.glob("*/__init__.py"))


def imports() -> dict[str, set[str]]:
    """Subject -> subjects that it imports; `<floor>.<package>`, or the name of what stands on top."""
    graph = grimp.build_graph("robotkube", cache_dir=None)
    arrows: dict[str, set[str]] = {}
    for module in graph.modules:
        importer = subject_of(module)
        imported = {subject_of(other) for other in graph.find_modules_directly_imported_by(module)}
        if importer:
            arrows.setdefault(importer, set()).update(name for name in imported if name and name != importer)
    return arrows


def subject_of(module: str) -> str:
    """The subject that a module belongs to; empty for what has none (errors, testing)."""
    parts = module.split(".")[1:]
    if parts and parts[0] in TOP:
        return parts[0]
    return ".".join(parts[:2]) if len(parts) > 1 and parts[0] in FLOORS else ""


def purpose(name: str) -> str:
    """The first sentence of a package's or module's docstring."""
    path = SOURCE / "robotkube" / name.replace(".", "/")
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return re.split(r"(?<=[.])\s", text, maxsplit=1)[0].rstrip(".:")


def picture(known: Mapping[str, set[str]]) -> Iterator[str]:
    """Floors from above, each with its subjects, those that import others of the floor first."""
    yield "  ".join(TOP)
    for floor in FLOORS:
        yield "-" * WIDTH
        line = f"{floor:<12}"
        for name in ordered(floor, known):
            if len(line) + len(name) + 2 > WIDTH:
                yield line.rstrip()
                line = " " * 12
            line += f"{name}  "
        yield line.rstrip()
    yield "-" * WIDTH
    yield "backoffs  errors  writes"


def ordered(floor: str, known: Mapping[str, set[str]]) -> Sequence[str]:
    """The subjects of a floor: each before what it imports."""
    left = set(subjects(floor))
    line = []
    while left:
        free = sorted(n for n in left if not any(f"{floor}.{n}" in known.get(f"{floor}.{o}", ()) for o in left - {n}))
        line += free
        left -= set(free)
    return line


def section() -> str:
    """What stands between the markers."""
    known = imports()
    rows = ["| subject | what it is | imports |", "| --- | --- | --- |"]
    for name in (*TOP, *(f"{floor}.{subject}" for floor in FLOORS for subject in ordered(floor, known))):
        others = ", ".join(sorted(known.get(name, ()), key=lambda other: (rank(other), other)))
        rows.append(f"| `{name}` | {purpose(name)} | {others or '-'} |")
    return "\n".join([BEGIN, "", "```text", *picture(known), "```", "", *rows, "", END])


def rank(name: str) -> int:
    """The floor of a subject, counted from above."""
    return FLOORS.index(name.partition(".")[0]) if name.partition(".")[0] in FLOORS else -1


def rewritten(page: str) -> str:
    """The page with today's section."""
    before, rest = page.split(BEGIN, 1)
    return before + section() + rest.split(END, 1)[1]


def write() -> Path:
    """Write the page; its path."""
    PAGE.write_text(rewritten(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    return PAGE
