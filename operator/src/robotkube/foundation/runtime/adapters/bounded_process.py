"""Calls answered in a process of their own, which is ended when one of them exceeds its bounds.

What strangers wrote, such as the patterns and references of a JSON Schema, can run for ever, and no thread of Python
can be stopped. Both sides speak JSON, a line each: `[name, place, [argument, ...]]` and the answer. What a call is
about, its first argument, is written down once, as `[place, subject]` without an answer, and from then on named by its
place: a schema is long, and asked about again and again.
"""

from __future__ import annotations

import json
import os
import resource
import select
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import IO, Any

from robotkube.errors import InputError, UnavailableError

CPU_SECONDS_MAX = 1.0  # of one call
DATA_BYTES_MAX = 160 * 1024 * 1024
ANSWER_SECONDS_MAX = 20.0  # the first call waits for the start of the process, on a machine that has other work
ANSWER_BYTES_MAX = 8 * 1024 * 1024
END_SECONDS_MAX = 2.0
CHUNK_BYTES = 64 * 1024
SUBJECTS_KEPT_MAX = 64


class BoundedProcess:
    """A process of `command`, which calls `serve`; started now, and again whenever it ended. Several threads may use
    it."""

    def __init__(self, command: Sequence[str]) -> None:
        self._command = list(command)
        self._lock = threading.Lock()
        self._process = self._start()

    def _start(self) -> subprocess.Popen[bytes]:
        self._places: dict[int, tuple[int, Any]] = {}
        return subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def close(self) -> None:
        """End the process."""
        with self._lock:
            self._end()

    def call(self, name: str, subject: Any, *arguments: Any) -> Any:
        """The answer of the function that `serve` knows by this name; `subject` is its first argument, an object that
        nobody changes. InputError when the call took more than its bounds, UnavailableError when there was no answer in
        ANSWER_SECONDS_MAX, which the call may not be to blame for."""
        text = json.dumps(arguments)
        with self._lock:
            if self._process.poll() is not None:
                self._end()
                self._process = self._start()
            try:
                place, introduction = self._placed(subject)
                return self._ask(f'{introduction}["{name}", {place}, {text}]\n'.encode())
            except Exception:
                self._end()
                raise

    def _placed(self, subject: Any) -> tuple[int, str]:
        """The place at which the process has the subject, and the line that puts it there; empty when it is there."""
        known = self._places.get(id(subject))
        if known is not None:
            return known[0], ""
        place = len(self._places)
        if place >= SUBJECTS_KEPT_MAX:
            place, _ = self._places.pop(next(iter(self._places)))
        self._places[id(subject)] = place, subject  # kept, so that nothing else can have its id
        return place, f"[{place}, {json.dumps(subject)}]\n"

    def _ask(self, line: bytes) -> Any:
        deadline = time.monotonic() + ANSWER_SECONDS_MAX
        question, answer = self._process.stdin, self._process.stdout
        assert question is not None
        assert answer is not None
        try:
            question.write(line)
            question.flush()
        except OSError as error:
            raise UnavailableError(f"the process that checks schemas has ended: {error}") from error
        data = bytearray()
        while not data.endswith(b"\n"):
            chunk = self._read(answer, deadline)
            data += chunk
            if not chunk or len(data) > ANSWER_BYTES_MAX:
                raise InputError(
                    f"checking takes more than {CPU_SECONDS_MAX:.0f} s or {DATA_BYTES_MAX >> 20} MiB; "
                    "simplify patterns and references of the schema, or write shorter values"
                )
        return json.loads(data)

    @staticmethod
    def _read(answer: IO[bytes], deadline: float) -> bytes:
        """The next bytes of the answer; empty when the process ended."""
        poll = select.poll()
        poll.register(answer, select.POLLIN)
        if not poll.poll(1000 * max(deadline - time.monotonic(), 0.0)):
            raise UnavailableError(f"a schema could not be checked within {ANSWER_SECONDS_MAX:.0f} s; try again later")
        return os.read(answer.fileno(), CHUNK_BYTES)

    def _end(self) -> None:
        self._process.kill()
        self._process.wait(END_SECONDS_MAX)
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                try:
                    stream.close()
                except BrokenPipeError:  # what was not read by the process that is gone
                    continue


def serve(functions: Mapping[str, Callable[..., Any]], questions: IO[bytes], answers: IO[bytes]) -> None:
    """Answer until `questions` ends; a call that needs more than CPU_SECONDS_MAX ends the process."""
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (DATA_BYTES_MAX, most))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's: the parent ends this process
    subjects: dict[int, Any] = {}
    for line in questions:
        signal.setitimer(signal.ITIMER_PROF, CPU_SECONDS_MAX)  # SIGPROF ends the process, also within a library
        question = json.loads(line)
        if len(question) == 2:
            subjects[question[0]] = question[1]
            continue
        name, place, arguments = question
        answer = json.dumps(functions[name](subjects[place], *arguments)).encode()
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        answers.write(answer + b"\n")
        answers.flush()
