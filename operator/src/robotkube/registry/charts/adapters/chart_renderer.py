"""Renderer of charts in one process that stays: for renderings that somebody waits for.

The program is ci/toolchain/cmd/chart-renderer: helm's own code, one request and one answer per line. It is started with
the bounds of helm_sandbox.py and gives up the right to open files, sockets and programs by itself.
"""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json

PROGRAM = "/usr/local/bin/chart-renderer"  # where the platform's image has it
PROGRAM_VARIABLE = "ROBOTKUBE_RENDERER"  # of the environment: another place
SECONDS_MAX = 5.0  # of a processor, for one chart
ANSWER_SECONDS_MAX = 60.0  # of the clock, on a machine that has other work
POLL_SECONDS = 0.1
PROCESSOR_SECONDS_MAX = 3_600  # of one process, over all its renderings
CLOCK_TICKS = os.sysconf("SC_CLK_TCK")
MEMORY_BYTES_MAX = 256 * 1024 * 1024
ANSWER_BYTES_MAX = 4 * 1024 * 1024
WORDS_MAX = 2_000
STARTS_MAX = 2
ENVIRONMENT = {"PATH": "", "GOMAXPROCS": "1", "GOMEMLIMIT": "96MiB"}  # of Go: collect before the bounds are met
NOT_STARTED = 126  # exit code when the program could not be started or confined
SANDBOX = Path(__file__).with_name("helm_sandbox.py")


class ChartRenderer:
    """The port ChartProgram on the program at `path`. A chart that takes more than `seconds` of a processor or ends a
    process that was started for it is refused; the next one gets another process. UnavailableError when there is no
    answer in `clock_seconds`, which the chart may not be to blame for. Several threads may use it."""

    def __init__(self, path: str, seconds: float = SECONDS_MAX, clock_seconds: float = ANSWER_SECONDS_MAX) -> None:
        self._path = path
        self._seconds = seconds
        self._clock_seconds = clock_seconds
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()

    def render(
        self, files: Mapping[str, bytes], values: Mapping[str, Any], release: str, namespace: str
    ) -> list[dict[str, Any]]:
        """The objects of the chart."""
        encoded = {path: base64.b64encode(data).decode() for path, data in files.items()}
        request = {"files": encoded, "values": values, "release": release, "namespace": namespace}
        line = json.dumps(request).encode() + b"\n"
        with self._lock:
            answer = self._answer(line)
        if answer.get("problem"):
            raise InputError(f"the chart cannot be rendered: {str(answer['problem'])[:WORDS_MAX]}")
        return list(answer.get("objects") or ())

    def close(self) -> None:
        """End the process."""
        with self._lock:
            self._end()

    def _answer(self, line: bytes) -> Mapping[str, Any]:
        """The answer to a request. What ended a process that had rendered other charts is tried with a new one."""
        for _ in range(STARTS_MAX):
            fresh = self._process is None
            process = self._process = self._process or self._start()
            text = self._exchange(process, line)
            if text.endswith(b"\n"):
                return _read(text)
            words = self._end()
            if process.returncode == NOT_STARTED:
                raise UnavailableError(f"charts cannot be rendered: {words}; the image needs {self._path}")
            if fresh:
                break
        raise InputError(
            f"the chart was not rendered within {self._seconds:g} s of a processor and {MEMORY_BYTES_MAX // 2**20} "
            "MiB; make its templates simpler"
        )

    def _exchange(self, process: subprocess.Popen[bytes], line: bytes) -> bytes:
        """Send a request and receive a line; less than one when the process ended, or was killed as too slow."""
        assert process.stdin is not None
        assert process.stdout is not None
        answered, late = threading.Event(), threading.Event()
        bounding = threading.Thread(target=self._bound, args=(process, answered, late), daemon=True)
        bounding.start()
        text = b""
        try:
            process.stdin.write(line)
            process.stdin.flush()
            text = process.stdout.readline(ANSWER_BYTES_MAX)
        except OSError:
            pass
        finally:
            answered.set()
            bounding.join()
        if late.is_set() and not text.endswith(b"\n"):
            self._end()
            raise UnavailableError(f"a chart could not be rendered within {self._clock_seconds:g} s; try again later")
        return text

    def _bound(self, process: subprocess.Popen[bytes], answered: threading.Event, late: threading.Event) -> None:
        """Kill a process that needs too much of a processor for one request, or gives no answer in time (`late`)."""
        deadline = time.monotonic() + self._clock_seconds
        begin = _processor_seconds(process.pid)
        pause = self._seconds  # it cannot need more of a processor than has passed
        while not answered.wait(max(min(pause, deadline - time.monotonic()), 0.0)):
            if time.monotonic() >= deadline:
                late.set()
            pause = max(begin + self._seconds - _processor_seconds(process.pid), 0.0)
            if late.is_set() or not pause:
                process.kill()
                return
            pause = max(pause, POLL_SECONDS)

    def _start(self) -> subprocess.Popen[bytes]:
        bounds = [str(bound) for bound in (PROCESSOR_SECONDS_MAX, MEMORY_BYTES_MAX, ANSWER_BYTES_MAX)]
        command = [sys.executable, "-I", "-S", str(SANDBOX), *bounds, self._path]
        return subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=ENVIRONMENT
        )

    def _end(self) -> str:
        """End the process, if there is one; what it said."""
        process, self._process = self._process, None
        if process is None:
            return ""
        process.kill()
        _, said = process.communicate()
        return said.decode("utf-8", "replace").strip()[:WORDS_MAX]


def _processor_seconds(pid: int) -> float:
    """What a process has taken of a processor; 0 when it has ended."""
    with suppress(OSError):
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / CLOCK_TICKS
    return 0.0


def _read(line: bytes) -> Mapping[str, Any]:
    """The program's answer; what a chart renders to may be of any depth."""
    try:
        return dict(read_json(line))
    except ValueError as error:
        raise InputError(f"the chart cannot be rendered: its objects are {error}") from error
