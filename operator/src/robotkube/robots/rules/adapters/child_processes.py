"""The pipes, frames and bounds of a rule in a process of its own; rules/host.py is what the process does with the rule.

Frames are a length (4 bytes) and a body. Questions go down as `marshal`, which is fast and which only this program
writes; replies come up as JSON, so that a rule can do no more harm than a wrong reply. The process is ended by the
kernel when an evaluation takes more processor time than its budget (SIGPROF), and by the parent when it is stuck.
"""

from __future__ import annotations

import contextlib
import json
import marshal
import os
import resource
import signal
import struct
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import entry_points
from typing import IO, Any

from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.robots.rules.core import Cause, RuleAnswer, RuleQuestion
from robotkube.robots.rules.core.plugin_api import ENTRY_POINT_GROUP
from robotkube.robots.rules.ports import Reply

COMMAND = (sys.executable, "-m", "robotkube.robots.rules.host")
FRAME_BYTES_MAX = 64 * 1024 * 1024
DATA_BYTES_MAX = 768 * 1024 * 1024
BATCH_MAX = 200
START_CPU_SECONDS_MAX = 20.0
END_SECONDS_MAX = 2.0
ERROR_CHARACTERS_MAX = 500
READY = "ready"

_LENGTH = struct.Struct("<I")


def installed_rules() -> Sequence[str]:
    """The names of the rules that installed packages offer."""
    return sorted(point.name for point in entry_points(group=ENTRY_POINT_GROUP))


class ChildProcess:
    """The parent's side (port RuleProcess). `job` is the first frame: what the process shall load.

    It has two threads, one that writes questions and one that reads replies; both end with the process.
    """

    def __init__(self, job: Mapping[str, Any], budget_seconds: float, command: Sequence[str] = COMMAND) -> None:
        self._budget_seconds = budget_seconds
        self._process = subprocess.Popen(list(command), stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._questions: deque[RuleQuestion] = deque()
        self._asked = threading.Semaphore(0)
        self._replies: deque[Reply] = deque()
        self._reply_arrived = threading.Event()
        self._stopped = False
        self.ready = False
        self.failure = ""
        for name, target in (("write", self._write), ("read", self._read)):
            arguments = (job,) if name == "write" else ()
            threading.Thread(target=target, args=arguments, name=f"rule-{name}", daemon=True).start()

    def ask(self, question: RuleQuestion) -> None:
        """See the port."""
        self._questions.append(question)
        self._asked.release()

    def replies(self) -> Sequence[Reply]:
        """See the port."""
        self._reply_arrived.clear()
        return [self._replies.popleft() for _ in range(len(self._replies))]

    def wait(self, seconds: float) -> None:
        """See the port."""
        self._reply_arrived.wait(seconds)

    def stop(self) -> None:
        """See the port."""
        self._stopped = True
        self._asked.release()
        self._process.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):  # the kernel ends it as soon as it can
            self._process.wait(END_SECONDS_MAX)

    def _write(self, job: Mapping[str, Any]) -> None:
        stream = self._process.stdin
        assert stream is not None
        try:
            write_frame(stream, marshal.dumps({**job, "budget_seconds": self._budget_seconds}))
            while not self._stopped:
                self._asked.acquire()
                batch = [tuple(self._questions.popleft()) for _ in range(min(len(self._questions), BATCH_MAX))]
                if batch:
                    write_frame(stream, marshal.dumps([_plain(question) for question in batch]))
        except OSError:
            return  # the process has ended, which the reading thread reports
        finally:
            _close(stream)

    def _read(self) -> None:
        stream = self._process.stdout
        assert stream is not None
        try:
            while (frame := read_frame(stream)) is not None:
                self._receive(read_json(frame))
        except (ValueError, KeyError, TypeError, IndexError) as error:
            self._fail(f"its process said what is no reply: {error}")
        else:
            self._fail(self._exit_reason())
        finally:
            _close(stream)

    def _receive(self, frame: Any) -> None:
        if frame == READY:
            self.ready = True
        elif isinstance(frame, dict):
            self._fail(str(frame["failure"])[:ERROR_CHARACTERS_MAX])
        else:
            self._replies.extend(_reply(entry) for entry in frame)
        self._reply_arrived.set()

    def _fail(self, text: str) -> None:
        self.failure = self.failure or text
        self._reply_arrived.set()

    def _exit_reason(self) -> str:
        code = self._process.wait()
        if code == -signal.SIGPROF:
            if not self.ready:
                return f"loading it took more than {START_CPU_SECONDS_MAX:g} s of processor time"
            return f"an evaluation took more than its budget of {self._budget_seconds:g} s of processor time"
        return f"its process ended with {signal.Signals(-code).name if code < 0 else f'exit code {code}'}"


def _plain(question: tuple[Any, ...]) -> tuple[Any, ...]:
    """A question in types that marshal knows."""
    return tuple(dict(part) if isinstance(part, Mapping) else part for part in question)


def _reply(entry: Any) -> Reply:
    if isinstance(entry, str):
        return Reply((), entry or "it failed and said nothing")
    return Reply([
        RuleAnswer(
            tuple(map(str, member)), int(verdict), {str(key): float(value) for key, value in detail.items()},
            tuple(Cause(str(topic), int(stamp), dict(values)) for topic, stamp, values in causes),
        )
        for member, verdict, detail, causes in entry
    ])  # fmt: skip


def _close(stream: IO[bytes]) -> None:
    try:
        stream.close()
    except OSError:  # what the process did not read any more
        return


# the child's side ----------------------------------------------------------------------------------------------------


def serve(load: Callable[[Mapping[str, Any]], Callable[[RuleQuestion], Sequence[RuleAnswer]]]) -> None:
    """Load the rule of the first frame and reply to questions until the parent ends or an evaluation fails."""
    questions, answers = _own_streams()
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (DATA_BYTES_MAX, most))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's: the parent ends this process
    frame = read_frame(questions)
    if frame is None:
        return
    job = marshal.loads(frame)  # noqa: S302  the parent's
    signal.setitimer(signal.ITIMER_PROF, START_CPU_SECONDS_MAX)
    try:
        answer = load(job)
    except Exception as error:
        _send(answers, {"failure": f"it cannot be loaded: {_described(error)}"})
        return
    signal.setitimer(signal.ITIMER_PROF, 0)
    _send(answers, READY)
    while (frame := read_frame(questions)) is not None:
        batch = [RuleQuestion(*entry) for entry in marshal.loads(frame)]  # noqa: S302  the parent's
        if not _reply_to(batch, answer, answers, job["budget_seconds"]):
            return


def _reply_to(
    batch: Sequence[RuleQuestion],
    answer: Callable[[RuleQuestion], Sequence[RuleAnswer]],
    answers: IO[bytes],
    budget_seconds: float,
) -> bool:
    """Reply to all questions of a frame, or up to the first at which the rule fails."""
    replies: list[str] = []
    failed = False
    for question in batch:
        signal.setitimer(signal.ITIMER_PROF, budget_seconds)  # SIGPROF ends the process, also within a library
        try:
            replies.append(json.dumps(answer(question)))
        except Exception as error:
            replies.append(json.dumps(_described(error)))
            failed = True
        signal.setitimer(signal.ITIMER_PROF, 0)
        if failed:
            break
    write_frame(answers, f"[{','.join(replies)}]".encode())
    return not failed


def _own_streams() -> tuple[IO[bytes], IO[bytes]]:
    """The pipes to the parent; what a rule prints goes to the log instead."""
    questions, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return questions, answers


def _send(stream: IO[bytes], value: Any) -> None:
    write_frame(stream, json.dumps(value).encode())


def _described(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"[:ERROR_CHARACTERS_MAX]


def write_frame(stream: IO[bytes], body: bytes) -> None:
    """Write a frame; OSError when nobody reads."""
    stream.write(_LENGTH.pack(len(body)) + body)
    stream.flush()


def read_frame(stream: IO[bytes]) -> bytes | None:
    """The next frame, None at the end; ValueError when it is cut off or too long."""
    head = stream.read(_LENGTH.size)
    if not head:
        return None
    (length,) = _LENGTH.unpack(head) if len(head) == _LENGTH.size else (FRAME_BYTES_MAX + 1,)
    if length > FRAME_BYTES_MAX:
        raise ValueError("a frame that is cut off or too long")
    body = stream.read(length)
    if len(body) < length:
        raise ValueError(f"a frame that ends after {len(body)} of {length} bytes")
    return body
