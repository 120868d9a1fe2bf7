"""Tiers of tests. Without a marker of one a test is fast: it may start Python, git and openssl, and nothing else."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

MARKERS = ("processes", "toolchain", "platform")
PROGRAMS = (sys.executable, "git", "openssl")

_start = subprocess.Popen.__init__


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """While a fast test runs, its fixtures included, another program is refused."""
    with pytest.MonkeyPatch.context() as patch:
        if not any(item.get_closest_marker(name) for name in MARKERS):
            patch.setattr(subprocess.Popen, "__init__", _start_if_fast)
        return (yield)


def _start_if_fast(process: subprocess.Popen[Any], args: Any, *more: Any, **options: Any) -> None:
    program = args if isinstance(args, str | Path) else args[0]
    if str(program) not in PROGRAMS:
        process._child_created = False  # type: ignore[attr-defined]  # for its __del__
        pytest.fail(f"{program}: a fast test starts no other program; mark its module `processes` or `toolchain`")
    _start(process, args, *more, **options)
