"""Child processes of `make test`: each is waited for within its time, and taken down with what its fixtures started."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

TEARDOWN_SECONDS_MAX = 120
LOWEST_PRIORITY = 19
_running: set[subprocess.Popen[bytes]] = set()


def run(
    command: Sequence[str],
    folder: Path,
    name: str,
    seconds_max: float,
    environment: Mapping[str, str] | None = None,
    output: Path | None = None,
) -> int:
    """The exit code of a command in a folder; -1 when it was ended since it took too long.

    With an `output`, a file, it writes there instead of to the terminal, and runs at the lowest priority, out of reach
    of a terminal's interrupt.
    """
    written = output.open("wb") if output else None
    with written or contextlib.nullcontext():
        process = subprocess.Popen(
            command,
            cwd=folder,
            env=environment,
            stdout=written,
            stderr=subprocess.STDOUT if written else None,
            start_new_session=written is not None,
        )
        _running.add(process)
        try:
            if written:
                _give_way(process.pid)
            return wait(process, name, seconds_max)
        finally:
            _running.discard(process)


def interrupt() -> None:
    """Send all that run an interrupt, by which they end."""
    for process in list(_running):
        with contextlib.suppress(ProcessLookupError):
            process.send_signal(signal.SIGINT)


def _give_way(pid: int) -> None:
    """Let a process, and what it starts, compute only what others leave: a session has one share where Linux groups
    processes by session, whatever is nice in it."""
    with contextlib.suppress(ProcessLookupError):
        os.setpriority(os.PRIO_PROCESS, pid, LOWEST_PRIORITY)
    with contextlib.suppress(OSError):
        Path(f"/proc/{pid}/autogroup").write_text(str(LOWEST_PRIORITY), encoding="ascii")


def wait(process: subprocess.Popen[bytes], name: str, seconds_max: float) -> int:
    """The exit code. An interrupt reaches pytest, too; it is given time to take down what its fixtures started."""
    try:
        return process.wait(seconds_max)
    except KeyboardInterrupt:
        _end(process)
        raise
    except subprocess.TimeoutExpired:
        print(f"{name}: not done after {seconds_max:.0f} s, ended", flush=True)
        process.send_signal(signal.SIGINT)
        _end(process)
        return -1


def _end(process: subprocess.Popen[bytes]) -> None:
    try:
        process.wait(TEARDOWN_SECONDS_MAX)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
