"""`make check`: formatting, lint, types, layers and the repository's own rules. Every check runs; the exit code is
1 if any failed.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path

from ci import boundaries, console, cores, links, markdown
from ci.errors import InputError

TOP = Path(__file__).resolve().parent.parent
CODE = ["operator/src", "operator/tests", "benchmarks", "ci", "scenarios", "gitops", "docs/examples"]
TYPED = ["operator/src/robotkube", "benchmarks", "ci", "scenarios", "gitops"]
LONGEST_MODULE_LINES = 500
MODULES_MAX = 15  # of one folder below operator/src
ROOTS = ("operator/src", "ci", "scenarios", "benchmarks")  # in each of them the name of a class means one thing
PUBLIC_CLASS = re.compile(r"^class ([A-Za-z]\w*)", re.MULTILINE)
TESTS = "operator/tests"
LEFTOVER = re.compile(r"\[(?:attr-defined|call-arg|name-defined)\]$")
"""What tells of a test that names what is not there any more."""
NO_LEFTOVER = re.compile(r'"[Oo]bject" has no attribute|has no attribute "_[a-z]|does not explicitly export')
"""Values of other libraries without types of their own, and what tests reach into on purpose."""
AS_PUBLISHED = "charts/earlier/"  # charts that stay byte for byte what was published


def tool(*command: str, folder: str = ".", seconds: int = 600) -> list[str]:
    """Run a tool; its output is the finding if it fails."""
    done = subprocess.run(command, cwd=TOP / folder, capture_output=True, text=True, timeout=seconds, check=False)
    return [] if done.returncode == 0 else [(done.stdout + done.stderr).strip()]


def types() -> list[str]:
    """Problems of types: each one in the code, and leftovers in the tests, which are not typed strictly."""
    return [
        line
        for text in tool("mypy", "--config-file", "operator/pyproject.toml", *TYPED, TESTS)
        for line in type_findings(text)
    ]


def type_findings(text: str) -> list[str]:
    """The lines of mypy's output that count; of the tests' only leftovers."""
    lines = [line for line in text.splitlines() if not line.startswith(("Found ", f"{TESTS}/"))]
    tests = [line for line in text.splitlines() if line.startswith(f"{TESTS}/")]
    return lines + [line for line in tests if LEFTOVER.search(line) and not NO_LEFTOVER.search(line)]


def tracked(*patterns: str) -> list[str]:
    done = subprocess.run(["git", "ls-files", "-z", *patterns], cwd=TOP, capture_output=True, text=True, check=True)
    return [name for name in done.stdout.split("\0") if name and (TOP / name).is_file()]


def repository_rules() -> list[str]:
    """Rules that no tool knows: no absolute paths of one machine, no registry addresses, no module of more than 500
    lines, no folder with too many of them, no name of two public classes of one tree, no page with lines that do not
    fit into a window, no core that is not pure, no package outside of the import contracts.
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
            if machine.search(line) and "ci/check.py" not in name:
                findings.append(f"{name}:{number}: absolute path of one machine: {line.strip()[:100]}")
            if registries.search(line) and "ci/check.py" not in name:
                findings.append(f"{name}:{number}: address of a package registry: {line.strip()[:100]}")
    for name in tracked("*.py"):
        lines = (TOP / name).read_bytes().count(b"\n")
        if lines > LONGEST_MODULE_LINES:
            findings.append(
                f"{name}: {lines} lines; a module of more than {LONGEST_MODULE_LINES} is more than one idea"
            )
    findings += crowded_folders(tracked("operator/src/*.py"))
    for root in ROOTS:
        findings += ambiguous_classes(tracked(f"{root}/*.py"))
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


def long_lines() -> list[str]:
    """Lines of pages that are longer than a window is wide, but for tables, code and what cannot be broken."""
    return [
        f"{name}:{line.number}: {len(line.text)} characters; a line of text has at most {markdown.WIDTH}"
        for name in tracked("*.md")
        if not name.startswith(AS_PUBLISHED)
        for line in markdown.too_long((TOP / name).read_text(encoding="utf-8-sig", errors="replace"))
    ]


CHECKS: dict[str, Callable[[], list[str]]] = {
    "format": lambda: tool("ruff", "format", "--check", "--config", "operator/pyproject.toml", *CODE),
    "lint": lambda: tool("ruff", "check", "--config", "operator/pyproject.toml", *CODE),
    "types": types,
    "layers": lambda: tool("lint-imports", "--config", "pyproject.toml", folder="operator"),
    "repository": repository_rules,
    "links": links.findings,
    "page": console.findings,
}


def main() -> int:
    os.environ["MYPYPATH"] = os.pathsep.join(str(TOP / folder) for folder in ("operator/src", "operator", ""))
    failed = 0
    for name, check in CHECKS.items():
        began = time.monotonic()
        findings = check()
        print(f"check {name}: {'failed' if findings else 'ok'} ({time.monotonic() - began:.1f} s)", flush=True)
        for finding in findings:
            print(finding, flush=True)
        failed += bool(findings)
    print(f"{len(CHECKS) - failed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
