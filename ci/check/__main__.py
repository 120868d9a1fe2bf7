"""`make check`: formatting, lint, types, layers and the repository's own rules. Every check runs; the exit code is
1 if any failed.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable

from ci import console
from ci.check import rules, tools
from ci.docs import links
from ci.folders import PROJECT

CHECKS: dict[str, Callable[[], list[str]]] = {
    "format": lambda: tools.tool("ruff", "format", "--check", "--config", "operator/pyproject.toml", *tools.CODE),
    "lint": lambda: tools.tool("ruff", "check", "--config", "operator/pyproject.toml", *tools.CODE),
    "types": tools.types,
    "layers": tools.layers,
    "repository": rules.repository_rules,
    "links": links.findings,
    "page": console.findings,
}


def main() -> int:
    os.environ["MYPYPATH"] = os.pathsep.join(str(PROJECT / folder) for folder in ("operator/src", "operator", ""))
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
