"""Fast tests start no program but Python, git and openssl."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest


def start(*command: str, **options: Any) -> int:
    return subprocess.run(command, check=False, timeout=60, capture_output=True, **options).returncode


@pytest.fixture(scope="module")
def refusal() -> str:
    """Of a program that a fixture starts."""
    with pytest.raises(pytest.fail.Exception) as refused:
        start("true")
    return str(refused.value)


def test_another_program_is_refused(refusal: str) -> None:
    assert "true: a fast test starts no other program; mark its module" in refusal
    with pytest.raises(pytest.fail.Exception, match="true"):
        start("true", shell=False, cwd="/")


def test_python_git_and_openssl_are_started() -> None:
    assert start(sys.executable, "-c", "raise SystemExit(3)") == 3
    assert start("git", "--version") == start("openssl", "version") == 0


@pytest.mark.processes
def test_a_test_of_another_tier_starts_any_program() -> None:
    assert start("true") == 0
