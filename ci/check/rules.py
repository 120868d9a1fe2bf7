"""The repository's own rules, which no tool knows."""

from __future__ import annotations

import re
import subprocess
from collections import Counter
from collections.abc import Iterable

from ci.check import assignments, boundaries, cores, words
from ci.docs import links, markdown
from ci.errors import InputError
from ci.folders import PROJECT

TOP = PROJECT
LONGEST_MODULE_LINES = 500
MODULES_MAX = 15  # of one folder below one of ROOTS
ROOTS = ("operator/src", "ci", "scenarios", "benchmarks")  # in each of them the name of a class means one thing
PUBLIC_CLASS = re.compile(r"^class ([A-Za-z]\w*)", re.MULTILINE)
AS_PUBLISHED = "charts/earlier/"  # charts that stay byte for byte what was published


def tracked(*patterns: str) -> list[str]:
    done = subprocess.run(["git", "ls-files", "-z", *patterns], cwd=TOP, capture_output=True, text=True, check=True)
    return [name for name in done.stdout.split("\0") if name and (TOP / name).is_file()]


def repository_rules() -> list[str]:
    """Rules that no tool knows: no absolute paths of one machine, no registry addresses, no module of more than 500
    lines, no folder with too many of them, no tuple assignment of values of several kinds, no name of two public
    classes of one tree, no private word in a name, no page with lines that do not fit into a window, no core that is
    not pure, no package outside of the import contracts.
    """
    findings = []
    if (TOP / "operator/__init__.py").exists():
        findings.append("operator/__init__.py: shadows the standard library's `operator`; remove it")
    machine = re.compile(r"(?<![\w.}])/(?:root|home/\w+|tmp/\w+)/[A-Za-z.]")
    registries = re.compile(r"https?://[\w.-]*(?:pypi|pythonhosted|npmjs|proxy\.golang|mirror|deb\.debian)[\w.-]*")
    for name in tracked("*.py", "*.md", "*.yaml", "*.txt", "*.toml", "Makefile", "*.sh", "*.mod", "*package-lock.json"):
        try:
            text = links.text(name, TOP)
        except InputError as error:
            findings.append(str(error))
            continue
        for number, line in enumerate(text.splitlines(), 1):
            if machine.search(line) and "ci/check/rules.py" not in name:
                findings.append(f"{name}:{number}: absolute path of one machine: {line.strip()[:100]}")
            if registries.search(line) and "ci/check/rules.py" not in name:
                findings.append(f"{name}:{number}: address of a package registry: {line.strip()[:100]}")
    for name in tracked("*.py"):
        lines = (TOP / name).read_bytes().count(b"\n")
        if lines > LONGEST_MODULE_LINES:
            findings.append(
                f"{name}: {lines} lines; a module of more than {LONGEST_MODULE_LINES} is more than one idea"
            )
    findings += crowded_folders(tracked(*(f"{root}/*.py" for root in ROOTS)))
    findings += mixed_assignments(tracked("*.py"))
    for root in ROOTS:
        findings += ambiguous_classes(tracked(f"{root}/*.py"))
    findings += private_words(tracked("*.py"))
    findings += long_lines()
    return findings + cores.findings(TOP / "operator/src/robotkube") + boundaries.findings(TOP)


def crowded_folders(names: Iterable[str]) -> list[str]:
    """Folders with more modules than a newcomer looks through; `__init__.py` does not count."""
    modules = Counter(name.rpartition("/")[0] for name in names if not name.endswith("/__init__.py"))
    return [
        f"{folder}: {count} modules; at most {MODULES_MAX}: give what belongs together a folder of its own"
        for folder, count in sorted(modules.items())
        if count > MODULES_MAX
    ]


def mixed_assignments(names: Iterable[str]) -> list[str]:
    """Statements that give several names values which have nothing to do with each other."""
    return [
        finding
        for name in names
        if not name.startswith(AS_PUBLISHED)
        for finding in assignments.findings(name, (TOP / name).read_text(encoding="utf-8"))
    ]


def ambiguous_classes(names: Iterable[str]) -> list[str]:
    """Names of public classes that stand for two things; names with an underscore are their modules' own."""
    places: dict[str, list[str]] = {}
    for name in names:
        for declared in PUBLIC_CLASS.finditer((TOP / name).read_text(encoding="utf-8")):
            places.setdefault(declared[1], []).append(name)
    return [
        f"{', '.join(where)}: class {name} stands for {len(where)} things; give each a name of its own"
        for name, where in sorted(places.items())
        if len(where) > 1
    ]


def private_words(names: Iterable[str]) -> list[str]:
    """Names with a word that has been replaced by one of the field; in a repository without the list there are none."""
    place = TOP / words.FILE
    if not place.is_file():
        return []
    try:
        vocabulary = words.read(place.read_text(encoding="utf-8"))
    except InputError as error:
        return [str(error)]
    return words.unused(vocabulary, TOP) + [
        finding
        for name in names
        if not name.startswith(AS_PUBLISHED)
        for finding in words.findings(name, (TOP / name).read_text(encoding="utf-8"), vocabulary)
    ]


def long_lines() -> list[str]:
    """Lines of pages that are longer than a window is wide, but for tables, code and what cannot be broken."""
    return [
        f"{name}:{line.number}: {len(line.text)} characters; a line of text has at most {markdown.WIDTH}"
        for name in tracked("*.md")
        if not name.startswith(AS_PUBLISHED)
        for line in markdown.too_long((TOP / name).read_text(encoding="utf-8-sig", errors="replace"))
    ]
