"""Tiers of tests. Without a marker of one a test is fast: it may start Python, git and openssl, and nothing else.

A hook of Python's audit events sees every way to start a program from this process and from processes that it forks; it
does not see what another program starts, a Python that the test starts among them, or what native code does.
"""

from __future__ import annotations

import mmap
import os
import re
import sys
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

MARKERS = ("processes", "toolchain", "platform")
ALLOWED = re.compile(r"python(3(\.[0-9]+)?)?|git|openssl")
PROGRAM_OF = {  # audit event -> its argument that names the program
    "subprocess.Popen": 0,
    "os.posix_spawn": 0,
    "os.exec": 0,
    "os.spawn": 1,
    "os.system": 0,
    "pty.spawn": 0,
}
BY_A_SHELL = ("os.system",)
NOTE_BYTES = 4096

_note = mmap.mmap(-1, NOTE_BYTES)  # shared with processes that are forked: what was refused, or zeros
_watching = False
_hooked = False


def pytest_collection_finish() -> None:
    """Begin to see programs when tests are collected: until then nothing is refused, and hundreds of thousands of
    events would be looked at."""
    global _hooked
    if not _hooked:
        sys.addaudithook(_audit)
        _hooked = True


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """While a fast test runs, its fixtures included, another program is refused."""
    global _watching
    _watching = not any(item.get_closest_marker(name) for name in MARKERS)
    _note[:] = bytes(NOTE_BYTES)
    try:
        return (yield)
    finally:
        _watching = False


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_setup() -> Generator[None, object, object]:
    return (yield from _phase())


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_call() -> Generator[None, object, object]:
    return (yield from _phase())


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown() -> Generator[None, object, object]:
    return (yield from _phase())


def _phase() -> Generator[None, object, object]:
    """Fail a phase in which a refusal was caught, in this process or in one that it forked."""
    try:
        outcome = yield
    except BaseException:
        _note[:] = bytes(NOTE_BYTES)
        raise
    note = bytes(_note).rstrip(b"\0")
    _note[:] = bytes(NOTE_BYTES)
    if note:
        pytest.fail(note.decode("utf-8", "replace"))
    return outcome


def _audit(event: str, arguments: tuple[Any, ...]) -> None:
    if not _watching or event not in PROGRAM_OF:
        return
    program = arguments[PROGRAM_OF[event]]
    if isinstance(program, list | tuple):
        program = program[0]
    text = os.fsdecode(program)
    if event in BY_A_SHELL or not (ALLOWED.fullmatch(Path(text).name) or text == sys.executable):
        message = f"{text}: a fast test starts no other program; mark its module `processes` or `toolchain`"
        note = message.encode("utf-8", "replace")[:NOTE_BYTES]
        _note[: len(note)] = note
        pytest.fail(message)
