"""Deliveries to a reaction of an installed package (port DeliverySender), in a process of its own, a line each way.

down  {"plugin": ..., "settings": ...}    once, then the document of each edge
up    {}                                  done;  {"again": why}: try again;  {"never": why}: give it up
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import entry_points
from typing import IO, Any

from robotkube.errors import InputError, RobotKubeError, UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.robots.reactions.core.plugin_api import ENTRY_POINT_GROUP
from robotkube.robots.reactions.ports.deliveries import EdgeDelivery

COMMAND = (sys.executable, "-m", "robotkube.robots.reactions.host")
START_SECONDS_MAX = 30.0
END_SECONDS_MAX = 2.0
LINE_BYTES_MAX = 64 * 1024
ERROR_CHARACTERS_MAX = 500


def installed_reactions() -> Sequence[str]:
    """The names of the reactions that installed packages offer."""
    return sorted(point.name for point in entry_points(group=ENTRY_POINT_GROUP))


class ProcessSender:
    """One installed reaction; its process is started when it is needed, and ended when it does not answer in time."""

    def __init__(
        self, plugin: str, settings: Mapping[str, Any], timeout_seconds: float, command: Sequence[str] = COMMAND
    ) -> None:
        self._plugin = plugin
        self._settings = settings
        self._timeout_seconds = timeout_seconds
        self._command = list(command)
        self._process: subprocess.Popen[bytes] | None = None

    def probe(self) -> None:
        """See the port: the reaction is loaded."""
        if self._process is None or self._process.poll() is not None:
            self.close()
            self._process = subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            job = {"plugin": self._plugin, "settings": dict(self._settings)}
            try:
                self._exchange(json.dumps(job).encode(), START_SECONDS_MAX)
            except RobotKubeError:
                self.close()  # it ends without the reaction, and must not pass for one that has it meanwhile
                raise

    def send(self, delivery: EdgeDelivery) -> None:
        """See the port."""
        self.probe()
        self._exchange(delivery.body, self._timeout_seconds)

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):  # the kernel ends it as soon as it can
                self._process.wait(END_SECONDS_MAX)
            for stream in (self._process.stdin, self._process.stdout):
                with contextlib.suppress(OSError):
                    stream.close() if stream else None
            self._process = None

    def _exchange(self, line: bytes, seconds: float) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(line + b"\n")
            self._process.stdin.flush()
            answer = read_json(self._answer(seconds))
        except (OSError, ValueError) as error:
            self.close()
            raise UnavailableError(f"{self._plugin}: {error}") from error
        if "never" in answer:
            raise InputError(f"{self._plugin}: {answer['never']}")
        if "again" in answer:
            raise UnavailableError(f"{self._plugin}: {answer['again']}")

    def _answer(self, seconds: float) -> bytes:
        """The next line of the process; ValueError when it does not come in time."""
        assert self._process is not None
        assert self._process.stdout is not None
        place = self._process.stdout.fileno()
        line = b""
        end = time.monotonic() + seconds
        while not line.endswith(b"\n"):
            if not select.select([place], [], [], max(0.0, end - time.monotonic()))[0]:
                raise ValueError(f"it has not answered for {seconds:g} s")
            part = os.read(place, LINE_BYTES_MAX)
            if not part or len(line) > LINE_BYTES_MAX:
                raise ValueError("its process has ended" if not part else "it says more than an answer")
            line += part
        return line


def serve(load: Callable[[str, Mapping[str, Any]], Callable[[Mapping[str, Any]], None]]) -> None:
    """Load the reaction, then react to one line after the other until the parent ends; the process's side."""
    lines, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a reaction prints goes to the log
    job = json.loads(lines.readline() or b"{}")
    try:
        react = load(job["plugin"], job["settings"])
    except Exception as error:
        _write_answer(answers, {"again": f"cannot be loaded: {_described(error)}"})
        return
    _write_answer(answers, {})
    while line := lines.readline():
        try:
            react(json.loads(line))
        except ValueError as error:
            _write_answer(answers, {"never": _described(error)})
        except Exception as error:
            _write_answer(answers, {"again": _described(error)})
        else:
            _write_answer(answers, {})


def _write_answer(stream: IO[bytes], answer: Mapping[str, str]) -> None:
    stream.write(json.dumps(answer).encode() + b"\n")
    stream.flush()


def _described(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"[:ERROR_CHARACTERS_MAX]
