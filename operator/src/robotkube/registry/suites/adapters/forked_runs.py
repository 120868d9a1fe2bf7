"""Runs each suite in a process of its own: one that hangs is killed, one that crashes or needs too much memory harms
nothing else. Processes are forked from a server that has everything imported, so that a start costs little.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import resource
import signal
import threading
import time
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.digests import canonical_json
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.registry.evidence.core.statements import SuiteResult
from robotkube.registry.suites.core.requests import SuiteRequest, read_progress, request_document

Target = Callable[[bytes, str], bytes]
"""Request (JSON) and test namespace -> progress (JSON), in the process; a function at the top of a module."""

LATE_SECONDS = 5.0  # beyond the suite's own time: for starting, and for reporting what happened
RESULT_BYTES_MAX = 4 * 1024 * 1024
DATA_BYTES_MAX = 768 * 1024 * 1024
END_SECONDS_MAX = 5.0


class ForkedSuites:
    """The port Executor. `target` runs in the process; `preload` are the modules that the server imports."""

    def __init__(self, target: Target, preload: Sequence[str] = (), late_seconds: float = LATE_SECONDS) -> None:
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(list(preload))
        self._target = target
        self._late_seconds = late_seconds
        self._running: set[BaseProcess] = set()
        self._lock = threading.Lock()

    def execute(self, request: SuiteRequest, namespace: str) -> SuiteResult:
        """Run the suite in a process; UnavailableError says how a process ended that gave no result."""
        seconds = request.rule.seconds + self._late_seconds
        data = self._run(canonical_json(request_document(request)), namespace, seconds, request.rule.seconds)
        progress = read_progress(read_json(data))
        if progress.result is None:
            raise InputError("the suite's process gave no result")
        return progress.result

    def stop(self) -> None:
        """Kill every running process."""
        with self._lock:
            running = list(self._running)
        for process in running:
            _kill(process)

    def _run(self, payload: bytes, namespace: str, seconds: float, allowed_seconds: int) -> bytes:
        ours, theirs = self._context.Pipe(duplex=False)
        process = self._context.Process(target=_body, args=(self._target, payload, namespace, theirs), daemon=True)
        with ours:
            with self._lock:  # who stops meanwhile kills it, too
                process.start()
                self._running.add(process)
            theirs.close()
            try:
                return _result(process, ours, seconds, allowed_seconds)
            finally:
                _kill(process)
                process.join(END_SECONDS_MAX)
                with self._lock:
                    self._running.discard(process)


def _result(process: BaseProcess, connection: Connection, seconds: float, allowed_seconds: int) -> bytes:
    deadline = time.monotonic() + seconds
    if not connection.poll(max(deadline - time.monotonic(), 0.0)):
        raise UnavailableError(f"the suite did not end within its {allowed_seconds} s and was ended")
    try:
        return connection.recv_bytes(RESULT_BYTES_MAX)
    except EOFError as error:
        process.join(END_SECONDS_MAX)
        raise UnavailableError(f"the suite's process ended without a result ({_ending(process.exitcode)})") from error
    except OSError as error:
        raise UnavailableError(f"the suite's result is longer than {RESULT_BYTES_MAX} bytes: {error}") from error


def _ending(code: int | None) -> str:
    if code is not None and code < 0:
        return f"{signal.Signals(-code).name}; SIGKILL is mostly a lack of memory"
    return f"exit code {code}"


def _kill(process: BaseProcess) -> None:
    """The process and all that it started: it leads a group of its own."""
    if process.pid is None or process.exitcode is not None:
        return
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.kill()


def _body(target: Target, payload: bytes, namespace: str, connection: Connection) -> None:
    os.setsid()
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (DATA_BYTES_MAX, most))
    connection.send_bytes(target(payload, namespace))
    connection.close()
