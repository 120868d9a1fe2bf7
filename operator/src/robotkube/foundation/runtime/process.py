"""The life of every robot process: settings of the pod, log lines, the end on SIGTERM.

    def body(process: Process) -> None:
        process.log("started", agent="vehicle-00")
        while not process.stopping.wait(0.025):
            ...

    if __name__ == "__main__":
        run("bridge", body, grace_seconds=2.5)

`run` never returns: 0 after body's return, 2 when an input is wrong (InputError), 3 when a service is unreachable
(UnavailableError), 1 for anything else. On SIGTERM or SIGINT `process.stopping` is set; when the body has not returned
`grace_seconds` later, a watchdog that needs no interpreter lock writes where every thread stands and ends the process,
since the middleware may hang in its own clean-up. PID 1 has no default signal actions, so both are set here.
"""

from __future__ import annotations

import faulthandler
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.runtime.loops.fencing import MOVABLE, NODE, is_movable

LINGER_SECONDS_MAX = 600.0
EXIT_DONE = 0
EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_UNREACHABLE = 3


@dataclass(frozen=True)
class PodSettings:
    """The places of a robot pod's inputs (see docs/reference/contracts.md); every path can be moved by a variable.
    `node` is the one it runs on, `placed_node` the one its release names, empty when it names none."""

    config_file: Path
    config_map: str | None
    broker_folder: Path
    database_folder: Path
    health_port: int
    node: str = ""
    placed_node: str = ""
    movable: bool = False

    @classmethod
    def from_environment(cls, environment: Mapping[str, str] = os.environ) -> PodSettings:
        """Read ROBOTKUBE_CONFIG, ROBOTKUBE_CONFIGMAP, ROBOTKUBE_SECRETS, ROBOTKUBE_HEALTH_PORT and NODE_NAME, and the
        release's placement next to the settings."""
        secrets = Path(environment.get("ROBOTKUBE_SECRETS", "/var/run/secrets/robotkube"))
        port = environment.get("ROBOTKUBE_HEALTH_PORT", "8081")
        if not port.isdecimal() or int(port) > 65535:
            raise InputError(f"ROBOTKUBE_HEALTH_PORT is {port!r}; give a port number")
        config_file = Path(environment.get("ROBOTKUBE_CONFIG", "/etc/robotkube/config.yaml"))
        beside = {key: (config_file.parent / key) for key in (NODE, MOVABLE)}
        placed = {key: read_text(path, "the release's place") for key, path in beside.items() if path.exists()}
        return cls(
            config_file=config_file,
            config_map=environment.get("ROBOTKUBE_CONFIGMAP"),
            broker_folder=secrets / "broker",
            database_folder=secrets / "database",
            health_port=int(port),
            node=environment.get("NODE_NAME", ""),
            placed_node=placed.get(NODE, ""),
            movable=is_movable(placed),
        )


def read_text(path: Path, what: str) -> str:
    """The text of a file; InputError names the file and what it is for."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: {what} cannot be read: {error}") from error


def read_secret(folder: Path, key: str) -> str:
    """The value of one key of a mounted Secret without a newline at its end; InputError names the file."""
    return read_text(folder / key, f"key {key} of the mounted Secret").rstrip("\n")


@dataclass
class Process:
    """A running process: its name, its log and whether it shall end. `removed`: its release is gone, so that it must do
    nothing any more, but not come back either; `signalled`: a signal asked it to end."""

    name: str
    grace_seconds: float
    stopping: threading.Event = field(default_factory=threading.Event)
    removed: threading.Event = field(default_factory=threading.Event)
    signalled: threading.Event = field(default_factory=threading.Event)

    def log(self, event: str, **fields: Any) -> None:
        """Write one canonical line to stderr: key=value on a terminal, JSON elsewhere."""
        write_line({"time": _now(), "process": self.name, "event": event, **fields})

    def stop(self) -> None:
        """Ask the body to return, and end the process when it has not after the grace time."""
        if not self.stopping.is_set():
            faulthandler.dump_traceback_later(self.grace_seconds, exit=True)
            self.stopping.set()


def write_line(fields: Mapping[str, Any]) -> None:
    """Write one log line to stderr."""
    if sys.stderr.isatty():
        line = " ".join(f"{key}={_plain(value)}" for key, value in fields.items())
    else:
        line = json.dumps(fields, default=str)
    sys.stderr.write(line + "\n")
    sys.stderr.flush()


def _plain(value: Any) -> str:
    text = str(value)
    return json.dumps(text) if " " in text or '"' in text or not text else text


def _now() -> str:
    seconds, rest = divmod(time.time_ns(), 1_000_000_000)
    return f"{time.strftime('%Y-%m-%dT%H:%M:%S', time.gmtime(seconds))}.{rest // 1_000_000:03d}Z"


def run(name: str, body: Callable[[Process], None], grace_seconds: float) -> NoReturn:
    """Run `body` on the main thread until it returns; see the module for signals and exit codes."""
    process = Process(name, grace_seconds)

    def handle(signal_number: int, frame: FrameType | None) -> None:
        process.signalled.set()
        process.stop()

    signal.signal(signal.SIGTERM, handle)
    signal.signal(signal.SIGINT, handle)
    code = _outcome(process, body)
    if process.removed.is_set():
        faulthandler.cancel_dump_traceback_later()
        # Ended now, the kubelet would start it again from the mounted settings.
        process.signalled.wait(LINGER_SECONDS_MAX)
    sys.stderr.flush()
    sys.stdout.flush()
    os._exit(code)  # not sys.exit: the middleware's clean-up at the interpreter's end may hang


def _outcome(process: Process, body: Callable[[Process], None]) -> int:
    try:
        body(process)
    except InputError as error:
        process.log("refused", error=str(error))
        return EXIT_USAGE
    except UnavailableError as error:
        process.log("unreachable", error=str(error))
        return EXIT_UNREACHABLE
    except Exception as error:
        import traceback

        process.log("failed", error=f"{type(error).__name__}: {error}", where=traceback.format_exc())
        return EXIT_FAILED
    process.log("ended")
    return EXIT_DONE
