"""What the tools find: ruff in form and style, mypy in types, import-linter in imports."""

from __future__ import annotations

import re
import subprocess

from ci.folders import PROJECT

CODE = ["operator/src", "operator/tests", "benchmarks", "ci", "scenarios", "gitops", "docs/examples"]
TYPED = ["operator/src/robotkube", "benchmarks", "ci", "scenarios", "gitops"]
TESTS = "operator/tests"
CONTRACTS = ("pyproject.toml", "../ci/check/contracts.toml")  # from the folder operator
LEFTOVER = re.compile(r"\[(?:attr-defined|call-arg|name-defined)\]$")
"""What tells of a test that names what is not there any more."""
NO_LEFTOVER = re.compile(r'"[Oo]bject" has no attribute|has no attribute "_[a-z]|does not explicitly export')
"""Values of other libraries without types of their own, and what tests reach into on purpose."""


def tool(*command: str, folder: str = ".", seconds: int = 600) -> list[str]:
    """Run a tool; its output is the finding if it fails."""
    done = subprocess.run(command, cwd=PROJECT / folder, capture_output=True, text=True, timeout=seconds, check=False)
    return [] if done.returncode == 0 else [(done.stdout + done.stderr).strip()]


def types() -> list[str]:
    """Problems of types: each one in the code, and leftovers in the tests, which are not typed strictly."""
    return [
        line
        for text in tool("mypy", "--config-file", "operator/pyproject.toml", *TYPED, TESTS)
        for line in type_findings(text)
    ]


def layers() -> list[str]:
    """Imports against the contracts: of the distribution, of all packages, of those of ci, benchmarks and scenarios."""
    return [line for file in CONTRACTS for line in tool("lint-imports", "--config", file, folder="operator")]


def type_findings(text: str) -> list[str]:
    """The lines of mypy's output that count; of the tests' only leftovers."""
    lines = [line for line in text.splitlines() if not line.startswith(("Found ", f"{TESTS}/"))]
    tests = [line for line in text.splitlines() if line.startswith(f"{TESTS}/")]
    return lines + [line for line in tests if LEFTOVER.search(line) and not NO_LEFTOVER.search(line)]
