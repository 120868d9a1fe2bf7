"""Reading settings files of the platform's processes (docs/reference/settings.md), and sending their logs as lines.

Every problem of a file is named at once, with its key; secrets are files, read once at the start.
"""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

from robotkube.errors import DocumentError, InputError
from robotkube.foundation.documents.core.former_keys import FormerKey, under_new_keys
from robotkube.foundation.documents.core.patterns import WORD
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.foundation.runtime.process import Process, read_secret, read_text

LOG_LEVELS = ("debug", "info", "warning", "error")
PATH = re.compile(r"/[^\0]*")
PORT_MAX = 65535
OCI_REGISTRY = FormerKey("registry", "oci_registry")
"""The former key of what names charts and images, in the settings of manager, gate and suite-runner."""

log = logging.getLogger(__name__)

_FIELD = re.compile(r" ([a-z_]+)=('(?:[^'\\]|\\.)*'|\"(?:[^\"\\]|\\.)*\"|\S+)")
T = TypeVar("T")


class WithLogLevel(Protocol):
    """Settings of a process that say how much it logs: one of LOG_LEVELS."""

    @property
    def log_level(self) -> str:
        """The least level of what it logs."""


L = TypeVar("L", bound=WithLogLevel)


@dataclass(frozen=True)
class Credentials:
    """An account: the two files of a credentials folder."""

    username: str
    password: str


@dataclass(frozen=True)
class Listen:
    """Address and ports at which a process serves HTTP: `health_port` answers health and metrics alone, None where
    there is no such port. `port` is served by HTTPS with the certificate in the folder `certificate`, if there is
    one."""

    address: str
    port: int
    health_port: int | None = None
    certificate: Path | None = None


def settings_path(environment: Mapping[str, str] = os.environ) -> Path:
    """Path of the settings file."""
    return Path(environment.get("ROBOTKUBE_CONFIG", "/etc/robotkube/config.yaml"))


def read_settings(
    path: Path, read: Callable[[Reader, Mapping[str, Any]], T], former_keys: Iterable[FormerKey] = ()
) -> T:
    """The settings in the file at `path`, as `read` makes them; DocumentError names the file and every problem, with
    the key that stands in the file. `former_keys` are still accepted, in the place of today's."""
    reader = Reader(str(path))
    renamed = under_new_keys(_document(path), former_keys)
    reader.problems += renamed.problems
    try:
        settings = read(reader, renamed.document)
    except (InputError, TypeError, ValueError, AttributeError, KeyError) as error:
        if not reader.problems:
            raise
        raise DocumentError(str(path), [renamed.as_written(problem) for problem in reader.problems]) from error
    reader.problems[:] = [renamed.as_written(problem) for problem in reader.problems]
    reader.finish()
    return settings


def warn_of_former_keys(path: Path, former_keys: Iterable[FormerKey]) -> None:
    """Log each former key that stands in the settings file at `path`, with its new name."""
    for former in under_new_keys(_document(path), former_keys).written:
        log.warning("settings have a former key file=%s key=%s new_key=%s", path, former.path, former.new_path)


def start_with_settings(
    process: Process,
    read: Callable[[Reader, Mapping[str, Any]], L],
    environment: Mapping[str, str],
    former_keys: Sequence[FormerKey] = (),
) -> L:
    """The settings of a process that starts, from its file; from now on its loops and adapters log through it, and the
    first of what they log is each former key in the file."""
    path = settings_path(environment)
    settings = read_settings(path, read, former_keys)
    send_logs(process, settings.log_level)
    warn_of_former_keys(path, former_keys)
    return settings


def _document(path: Path) -> Mapping[str, Any]:
    return read_mapping(read_text(path, "settings"), str(path))


def credentials(reader: Reader, value: Any, path: str) -> Credentials:
    """The account in the folder that `value` names."""
    folder = reader.word(value, path, PATH)
    return Credentials(_secret(reader, folder, "username", path), _secret(reader, folder, "password", path))


def secret(reader: Reader, value: Any, path: str) -> str:
    """The content of the secret file that `value` names."""
    place = Path(reader.word(value, path, PATH))
    return _secret(reader, str(place.parent), place.name, path)


def _secret(reader: Reader, folder: str, name: str, path: str) -> str:
    if not folder or not name:
        return ""
    try:
        text = read_secret(Path(folder), name)
    except InputError as error:
        reader.problems.append(f"{path}: {error}")
        return ""
    if not text:
        reader.problems.append(f"{path}: {folder}/{name} is empty; put the secret into it")
    return text


def listen(reader: Reader, value: Any, path: str = "listen", encrypts: bool = False) -> Listen:
    """Address and ports; 0 is any free one. `encrypts`: the process can serve by HTTPS, so it may have a
    certificate."""
    more = ["certificate"] if encrypts else []
    settings = reader.mapping(value or {}, path, ["address", "port"], ["health_port", *more])
    port = _port(reader, settings.get("port"), f"{path}.port")
    health = settings.get("health_port")
    health_port = None if health is None else _port(reader, health, f"{path}.health_port")
    if health_port and health_port == port:
        reader.problems.append(f"{path}.health_port: is the same as {path}.port; give it a port of its own")
    address = reader.word(settings.get("address"), f"{path}.address", WORD)
    folder = settings.get("certificate")
    certificate = None if folder is None else Path(reader.word(folder, f"{path}.certificate", PATH))
    return Listen(address, port, health_port, certificate)


def _port(reader: Reader, value: Any, path: str) -> int:
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= PORT_MAX:
        return value
    reader.problems.append(f"{path}: must be a whole number from 0 to {PORT_MAX}")
    return 0


def log_level(reader: Reader, value: Any, path: str = "log_level") -> str:
    """One of LOG_LEVELS."""
    if value not in LOG_LEVELS:
        reader.problems.append(f"{path}: must be one of {', '.join(LOG_LEVELS)}")
        return "info"
    return str(value)


def agent_namespaces(reader: Reader, value: Any, path: str = "agents") -> frozenset[str]:
    """The namespaces of the declared agents."""
    namespaces = set()
    for index, item in enumerate(reader.sequence(value, path)):
        agent = reader.mapping(item, f"{path}[{index}]", ["name", "role", "namespace", "records"])
        namespaces.add(reader.word(agent.get("namespace"), f"{path}[{index}].namespace", WORD))
    return frozenset(namespaces - {""})


class _ProcessLogHandler(logging.Handler):
    """Log handler that writes records of loops and adapters as lines of the process: `event key=value ...` becomes
    fields."""

    def __init__(self, process: Process) -> None:
        super().__init__()
        self._process = process

    def emit(self, record: logging.LogRecord) -> None:
        event, fields = split_message(record.getMessage())
        if record.exc_info and record.exc_info[1]:
            fields["error"] = f"{record.exc_info[0].__name__ if record.exc_info[0] else ''}: {record.exc_info[1]}"
        fields.pop("event", None)
        self._process.log(event, **{**fields, "level": record.levelname.lower()})


def split_message(message: str) -> tuple[str, dict[str, str]]:
    """`event key=value key='quoted value'` as event and fields; a last field `reason=` has the rest of the line."""
    message, separator, reason = message.partition(" reason=")
    fields = {key: value.strip("'\"") for key, value in _FIELD.findall(message)}
    if separator:
        fields["reason"] = reason
    return _FIELD.sub("", message), fields


def send_logs(process: Process, level: str) -> None:
    """Let loops and adapters log through `process` from now on; libraries only from warnings on."""
    root = logging.getLogger()
    root.handlers[:] = [_ProcessLogHandler(process)]
    root.setLevel(logging.WARNING)
    logging.getLogger("robotkube").setLevel(level.upper())
