"""What a pod of the probe does with sockets and file systems: it serves the time at one port and is silent at another,
and it asks a neighbour, the name service and the broker."""

from __future__ import annotations

import os
import random
import socket
import socketserver
import threading
import time
from collections.abc import Callable, Mapping, Sequence

from robotkube.backoffs import backoff
from robotkube.delivery.preflight.core.probing.answers import (
    CLOSED_PORT,
    OPEN_PORT,
    DiskSpace,
    ProbeAnswer,
    ProbeQuestions,
)
from robotkube.delivery.preflight.core.probing.clocks import ClockExchange, ahead

CONNECT_SECONDS_MAX = 1.5
NAMES_SECONDS_MAX = 4.0
EXCHANGES = 12
OPEN_ATTEMPTS, CLOSED_ATTEMPTS = 3, 3
PAUSE_SECONDS = 0.5
"""A policy works a little later than it is made: what it denies is asked for again, at most so often, after this pause
and up to as much again, since all pods of a probe begin at once."""
LINE_BYTES_MAX = 64
FILE_SYSTEMS: Mapping[str, str] = {"pods": "/tmp", "images": "/"}  # noqa: S108 - in the pod: its volume, and its image


class _Time(socketserver.StreamRequestHandler):
    """Answers each line with the time."""

    timeout = 20.0

    def handle(self) -> None:
        while self.rfile.readline(LINE_BYTES_MAX):
            self.wfile.write(f"{time.time():.6f}\n".encode())


class TimeServer(socketserver.ThreadingTCPServer):
    """A server that says the time, at every address of the pod."""

    allow_reuse_address = True
    daemon_threads = True

    def __init__(self, port: int) -> None:
        super().__init__(("", port), _Time)


def serve(stopping: threading.Event, ports: tuple[int, int] = (OPEN_PORT, CLOSED_PORT)) -> None:
    """Serve at both ports until told to stop."""
    servers = [TimeServer(port) for port in ports]
    for server in servers:
        threading.Thread(target=server.serve_forever, name="serve", daemon=True).start()
    stopping.wait()
    for server in servers:
        server.shutdown()
        server.server_close()


def answer(
    questions: ProbeQuestions,
    ports: tuple[int, int] = (OPEN_PORT, CLOSED_PORT),
    sleep: Callable[[float], object] = time.sleep,
    file_systems: Mapping[str, str] = FILE_SYSTEMS,
) -> ProbeAnswer:
    """Find out everything that is asked for."""
    clock_ahead, clock_within, clock_words = _clock(questions.clock, ports[0])
    return ProbeAnswer(
        names=_all_resolved(questions.names),
        clock_ahead=clock_ahead,
        clock_within=clock_within,
        clock_words=clock_words,
        open_words=_reached(questions.neighbour, ports[0], OPEN_ATTEMPTS, sleep),
        closed=_stays_open(questions.neighbour, ports[1], sleep),
        broker_words=_reached(questions.broker_host, questions.broker_port, 1, sleep) if questions.broker_host else "",
        disks={what: _space(path) for what, path in file_systems.items()},
    )


def _clock(host: str, port: int) -> tuple[float, float, str]:
    try:
        with socket.create_connection((host, port), CONNECT_SECONDS_MAX) as connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            lines = connection.makefile("rb")
            exchanges = []
            for _ in range(EXCHANGES):
                asked = time.time()
                connection.sendall(b"\n")
                said = float(lines.readline(LINE_BYTES_MAX))
                exchanges.append(ClockExchange(asked, said, time.time()))
            return (*ahead(exchanges), "")
    except (OSError, ValueError) as error:
        return 0.0, 0.0, f"the clock at {host} was not read: {error or type(error).__name__}"


def _all_resolved(names: Sequence[str]) -> Mapping[str, str]:
    """Why each name is not resolved; empty when it is. The library has no bound of time, so it is left behind."""
    words = dict.fromkeys(names, f"no answer within {NAMES_SECONDS_MAX:g} s")

    def resolve(name: str) -> None:
        try:
            socket.getaddrinfo(name, None, type=socket.SOCK_STREAM)
            words[name] = ""
        except OSError as error:
            words[name] = str(error) or type(error).__name__

    asking = [threading.Thread(target=resolve, args=(name,), name="resolve", daemon=True) for name in names]
    deadline = time.monotonic() + NAMES_SECONDS_MAX
    for one in asking:
        one.start()
    for one in asking:
        one.join(max(0.0, deadline - time.monotonic()))
    return dict(words)


def _reached(host: str, port: int, attempts: int, sleep: Callable[[float], object]) -> str:
    """Why no connection is made; empty when one is."""
    words = ""
    for attempt in range(attempts):
        if attempt:
            sleep(PAUSE_SECONDS + backoff(0, PAUSE_SECONDS, PAUSE_SECONDS, random.random))
        try:
            socket.create_connection((host, port), CONNECT_SECONDS_MAX).close()
        except OSError as error:
            words = str(error) or type(error).__name__
        else:
            return ""
    return words


def _stays_open(host: str, port: int, sleep: Callable[[float], object]) -> bool:
    """Return whether a port is reached each time."""
    for attempt in range(CLOSED_ATTEMPTS):
        if attempt:
            sleep(PAUSE_SECONDS + backoff(0, PAUSE_SECONDS, PAUSE_SECONDS, random.random))
        if _reached(host, port, 1, sleep):
            return False
    return True


def _space(path: str) -> DiskSpace:
    file_system = os.statvfs(path)
    return DiskSpace(file_system.f_bavail * file_system.f_frsize, file_system.f_blocks * file_system.f_frsize)
