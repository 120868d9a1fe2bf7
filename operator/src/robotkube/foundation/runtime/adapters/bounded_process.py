"""Calls answered in a process of their own, which is ended when one of them exceeds its bounds.

What strangers wrote, such as the patterns and references of a JSON Schema, can run for ever, and no thread of Python
can be stopped. Both sides speak JSON, a line each: `[name, place, [argument, ...]]` and the answer. What a call is
about, its first argument, is written down once, as `[place, subject]` without an answer, and from then on named by its
place: a schema is long, and asked about again and again.

Who asks may go on meanwhile: calls are answered in their order, and each has bounds of its own. No more than what the
pipe holds is sent ahead, so that neither side waits for the other to read.
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
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import IO, Any

from robotkube.errors import InputError, UnavailableError

CPU_SECONDS_MAX = 1.0  # of one call
DATA_BYTES_MAX = 160 * 1024 * 1024
ANSWER_SECONDS_MAX = 20.0  # the first call waits for the start of the process, on a machine that has other work
ANSWER_BYTES_MAX = 8 * 1024 * 1024
END_SECONDS_MAX = 2.0
CHUNK_BYTES = 64 * 1024
SUBJECTS_KEPT_MAX = 64
AHEAD_BYTES_MAX = 32 * 1024  # of calls without an answer; Linux's pipes hold twice as much
AHEAD_MAX = 64


@dataclass(eq=False)
class SentCall:
    """A call that was sent. `wait` returns once `answer` or `error` is there."""

    name: str
    subject: Any
    text: str
    wait: Callable[[SentCall], None]
    answer: Any = None
    error: Exception | None = None
    done: bool = False

    def result(self) -> Any:
        """The answer, or the error, as BoundedProcess.call has it."""
        self.wait(self)
        if self.error is not None:
            raise self.error
        return self.answer


class BoundedProcess:
    """A process of `command`, which calls `serve`; started now, and again whenever it ended. Several threads may use
    it."""

    def __init__(self, command: Sequence[str]) -> None:
        self._command = list(command)
        self._lock = threading.Lock()
        self._process = self._start()

    def _start(self) -> subprocess.Popen[bytes]:
        self._places: dict[int, tuple[int, Any]] = {}
        self._received = bytearray()
        self._ahead: deque[SentCall] = deque()  # sent, without an answer yet
        return subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def close(self) -> None:
        """End the process, once what was asked has its answer."""
        with self._lock:
            self._finish_all()
            self._end()

    def call(self, name: str, subject: Any, *arguments: Any) -> Any:
        """The answer of the function that `serve` knows by this name; `subject` is its first argument, an object that
        nobody changes. InputError when the call took more than its bounds, UnavailableError when there was no answer in
        ANSWER_SECONDS_MAX, which the call may not be to blame for."""
        return self.ask(name, subject, *arguments).result()

    def ask(self, name: str, subject: Any, *arguments: Any) -> SentCall:
        """Send a call. Its `result` is what `call` gives; whoever asks may do other things first."""
        asked = SentCall(name, subject, json.dumps(arguments), self._wait)
        with self._lock:
            self._send(asked)
        return asked

    def _wait(self, asked: SentCall) -> None:
        with self._lock:
            while not asked.done:
                self._finish()

    def _send(self, asked: SentCall) -> None:
        if self._process.poll() is not None:
            self._finish_all()
            self._begin_again()
        ahead = len(asked.text) + sum(len(one.text) for one in self._ahead)
        if id(asked.subject) not in self._places or ahead > AHEAD_BYTES_MAX or len(self._ahead) >= AHEAD_MAX:
            self._finish_all()
        place, introduction = self._placed(asked.subject)
        line = f'{introduction}["{asked.name}", {place}, {asked.text}]\n'.encode()
        self._ahead.append(asked)
        question = self._process.stdin
        assert question is not None
        try:
            question.write(line)
            question.flush()
        except OSError as error:
            if len(self._ahead) == 1:  # else the process ended by an earlier one, and this one is sent again
                asked.error = UnavailableError(f"the process that checks schemas has ended: {error}")
                self._ahead.clear()
                asked.done = True
                self._begin_again()

    def _begin_again(self) -> None:
        """A new process, to which what has no answer yet is sent again."""
        unanswered = list(self._ahead)
        self._end()
        self._process = self._start()
        for asked in unanswered:
            self._send(asked)

    def _finish_all(self) -> None:
        while self._ahead:
            self._finish()

    def _finish(self) -> None:
        """Wait for the answer of the call that was sent first."""
        asked = self._ahead.popleft()
        try:
            asked.answer = json.loads(self._line())
            asked.done = True
        except Exception as error:
            asked.error = error
            asked.done = True
            self._begin_again()

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

    def _line(self) -> bytes:
        deadline = time.monotonic() + ANSWER_SECONDS_MAX
        answer = self._process.stdout
        received = self._received
        assert answer is not None
        end = received.find(b"\n")
        while end < 0:
            chunk = self._read(answer, deadline)
            begin = len(received)
            received += chunk
            end = received.find(b"\n", begin)
            if not chunk or (end if end >= 0 else len(received)) > ANSWER_BYTES_MAX:
                raise InputError(
                    f"checking takes more than {CPU_SECONDS_MAX:.0f} s or {DATA_BYTES_MAX >> 20} MiB; "
                    "simplify patterns and references of the schema, or write shorter values"
                )
        line = bytes(received[:end])
        del received[: end + 1]
        return line

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
