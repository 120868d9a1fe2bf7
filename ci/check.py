"""`make check`: formatting, lint, types, layers and the repository's own rules. Every check runs; the exit code is
1 if any failed.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

TOP = Path(__file__).resolve().parent.parent
CODE = ["operator/src", "operator/tests", "ci", "scenarios"]
TYPED = ["operator/src/robotkube", "ci", "scenarios"]
LONGEST_MODULE_LINES = 500


def tool(*command: str, folder: str = ".", seconds: int = 600) -> list[str]:
    """Run a tool; its output is the finding if it fails."""
    done = subprocess.run(command, cwd=TOP / folder, capture_output=True, text=True, timeout=seconds, check=False)
    return [] if done.returncode == 0 else [(done.stdout + done.stderr).strip()]


def tracked(*patterns: str) -> list[str]:
    done = subprocess.run(["git", "ls-files", "-z", *patterns], cwd=TOP, capture_output=True, text=True, check=True)
    return [name for name in done.stdout.split("\0") if name and (TOP / name).is_file()]


def repository_rules() -> list[str]:
    """Rules that no tool knows: no absolute paths of one machine, no registry addresses, no module of more than 500
    lines.
    """
    findings = []
    if (TOP / "operator/__init__.py").exists():
        findings.append("operator/__init__.py: shadows the standard library's `operator`; remove it")
    machine = re.compile(r"(?<![\w.}])/(?:root|home/\w+|tmp/\w+)/[A-Za-z.]")
    registries = re.compile(r"https?://[\w.-]*(?:pypi|pythonhosted|npmjs|proxy\.golang|mirror|deb\.debian)[\w.-]*")
    for name in tracked("*.py", "*.md", "*.yaml", "*.txt", "*.toml", "Makefile", "*.sh", "*.mod"):
        for number, line in enumerate((TOP / name).read_text(encoding="utf-8").splitlines(), 1):
            if machine.search(line) and "ci/check.py" not in name:
                findings.append(f"{name}:{number}: absolute path of one machine: {line.strip()[:100]}")
            if registries.search(line) and "ci/check.py" not in name:
                findings.append(f"{name}:{number}: address of a package registry: {line.strip()[:100]}")
    for name in tracked("*.py"):
        lines = (TOP / name).read_text(encoding="utf-8").count("\n")
        if lines > LONGEST_MODULE_LINES:
            findings.append(
                f"{name}: {lines} lines; a module of more than {LONGEST_MODULE_LINES} is more than one idea"
            )
    return findings


CHECKS: dict[str, Callable[[], list[str]]] = {
    "format": lambda: tool("ruff", "format", "--check", "--config", "operator/pyproject.toml", *CODE),
    "lint": lambda: tool("ruff", "check", "--config", "operator/pyproject.toml", *CODE),
    "types": lambda: tool("mypy", "--config-file", "operator/pyproject.toml", *TYPED),
    "layers": lambda: tool("lint-imports", "--config", "pyproject.toml", folder="operator"),
    "repository": repository_rules,
}


def main() -> int:
    os.environ["MYPYPATH"] = str(TOP / "operator/src")
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
