"""`make test`: five groups, each with its time; `--thorough` runs the slower proofs instead. Exit code 1 when
anything failed.

The tool chain and the images come first (built once, cached), since forge and cluster tests need the real programs.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

from ci import preparing

TOP = Path(__file__).resolve().parent.parent
TESTS = "operator/tests"


@dataclass(frozen=True)
class Group:
    """One group of tests: folders, or the checks when there are none. `seconds_max` kills a group that hangs."""

    name: str
    folders: tuple[str, ...]
    seconds_max: int
    needs: str = "nothing"


PURE = ("unit", "domain", "manager", "detector", "data_path", "scenario", "images")
REAL = ("charts", "forge", "database", "apiserver", "cluster")

GROUPS = (
    Group("check", (), 600),
    Group("unit", PURE, 900),
    Group("charts", ("charts",), 600, "toolchain"),
    Group("forge", ("forge", "database", "apiserver"), 900, "toolchain"),
    Group("cluster", ("cluster",), 2400, "images"),
)
THOROUGH = Group("thorough", PURE + REAL, 5400, "images")


@dataclass(frozen=True)
class Result:
    """Counts of one group, and its wall time in seconds."""

    name: str
    passed: int
    failed: int
    skipped: int
    seconds: float


def run_checks(group: Group) -> tuple[int, int, int]:
    done = subprocess.run([sys.executable, "-m", "ci.check"], cwd=TOP, timeout=group.seconds_max, check=False)
    return (1, 0, 0) if done.returncode == 0 else (0, 1, 0)


def run_pytest(group: Group, marker: str) -> tuple[int, int, int]:
    """Run a group's folders that exist; a run that dies counts as one failure more than what it reported."""
    folders = [f"{TESTS}/{name}" for name in group.folders if (TOP / TESTS / name).is_dir()]
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = [sys.executable, "-m", "pytest", "-c", "operator/pyproject.toml", "-m", marker]
        command += ["--durations=5", f"--junitxml={report}", "-p", "no:cacheprovider", *folders]
        try:
            code = subprocess.run(command, cwd=TOP, timeout=group.seconds_max, check=False).returncode
        except subprocess.TimeoutExpired:
            print(f"{group.name}: not done after {group.seconds_max} s, killed", flush=True)
            code = -1
        passed, failed, skipped = counts(report)
    if code != 0 and not failed:
        failed = 1
    return passed, failed, skipped


def counts(report: Path) -> tuple[int, int, int]:
    """(passed, failed, skipped) of a JUnit file; zeros when there is none."""
    if not report.exists():
        return 0, 0, 0
    suites = ElementTree.parse(report).getroot().iter("testsuite")  # noqa: S314 - written by our own pytest
    total = failed = skipped = 0
    for suite in suites:
        total += int(suite.get("tests", 0))
        failed += int(suite.get("failures", 0)) + int(suite.get("errors", 0))
        skipped += int(suite.get("skipped", 0))
    return total - failed - skipped, failed, skipped


def run(group: Group, marker: str) -> Result:
    print(f"\n== {group.name}", flush=True)
    preparing.prepare(group.needs)
    began = time.monotonic()
    passed, failed, skipped = run_pytest(group, marker) if group.folders else run_checks(group)
    return Result(group.name, passed, failed, skipped, time.monotonic() - began)


def main() -> int:
    parser = argparse.ArgumentParser(prog="make test", description=__doc__)
    parser.add_argument("--thorough", action="store_true", help="run the slower proofs")
    parser.add_argument("--only", action="append", choices=[group.name for group in GROUPS], help="run only this group")
    arguments = parser.parse_args()
    os.environ.setdefault("PYTHONHASHSEED", "0")
    if arguments.thorough:
        results = [run(THOROUGH, "thorough")]
    else:
        chosen = [group for group in GROUPS if not arguments.only or group.name in arguments.only]
        results = [run(group, "not thorough") for group in chosen]
    print("\ngroup      passed  failed skipped  seconds")
    for result in results:
        print(f"{result.name:<10} {result.passed:>6} {result.failed:>7} {result.skipped:>7} {result.seconds:>8.1f}")
    passed, failed, skipped = (sum(getattr(one, key) for one in results) for key in ("passed", "failed", "skipped"))
    print(f"{passed} passed, {failed} failed, {skipped} skipped", flush=True)
    return 1 if failed or not passed else 0


if __name__ == "__main__":
    sys.exit(main())
