"""A real FerretDB process with accounts, as the embedded profile runs it."""

from __future__ import annotations

import os
import socket
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pymongo

from robotkube.foundation.certificates.adapters.verification import ServerVerification
from robotkube.foundation.certificates.core.lives import Issued
from robotkube.foundation.database.adapters.encryption import encrypt
from robotkube.registry.suites.core.namespace_contents import (
    DATABASE_FOLDER,
    DATABASE_LISTENERS,
    DATABASE_TLS_PORT,
    database_files,
)
from tests.stages.programs import free_port, program

START_SECONDS_MAX = 20.0
STOP_SECONDS_MAX = 10.0
NAME = "suite-database"
SETUP_USER = "administrator"
SETUP_PASSWORD = "set-up password"  # noqa: S105


@dataclass
class DatabaseServer:
    """One FerretDB process on a folder; it can be killed and started again on the same data and port. It listens on
    `address`; tests reach it on the loopback. With `issued` it speaks TLS alone, and shows that certificate, which is
    for `name`."""

    folder: Path
    address: str = "127.0.0.1"
    port: int = field(default_factory=free_port)
    issued: Issued | None = None
    name: str = NAME
    process: subprocess.Popen[bytes] | None = None
    clients: list[pymongo.MongoClient[dict[str, Any]]] = field(default_factory=list)

    @property
    def tls(self) -> ServerVerification | None:
        """The authority and the name by which clients verify it; None when it does not encrypt."""
        return ServerVerification(self.folder / "ca.crt", self.name) if self.issued else None

    def start(self) -> None:
        (self.folder / "data").mkdir(parents=True, exist_ok=True)
        command = [
            program("ferretdb"), "--handler=sqlite", f"--sqlite-url=file:{self.folder}/data/",
            f"--state-dir={self.folder}", *self._listeners(), "--debug-addr=-", "--telemetry=disable",
            "--setup-database=admin", "--log-level=ERROR",
        ]  # fmt: skip
        environment = {
            **os.environ,
            "FERRETDB_SETUP_USERNAME": SETUP_USER,
            "FERRETDB_SETUP_PASSWORD": SETUP_PASSWORD,
        }
        with (self.folder / "log").open("ab") as log:
            self.process = subprocess.Popen(command, env=environment, stdout=log, stderr=log)
        deadline = time.monotonic() + START_SECONDS_MAX
        while not self._listening():
            assert self.process.poll() is None, (self.folder / "log").read_text()
            assert time.monotonic() < deadline, "FerretDB did not listen in time"
            time.sleep(0.01)

    def _listeners(self) -> list[str]:
        """The same as of a test namespace's, on this folder and port."""
        if self.issued is None:
            return [f"--listen-addr={self.address}:{self.port}"]
        for name, text in database_files(self.issued).items():
            (self.folder / name).write_text(text)
        places = {DATABASE_FOLDER: str(self.folder), f":{DATABASE_TLS_PORT}": f"{self.address}:{self.port}"}
        arguments = list(DATABASE_LISTENERS["ferretdb", True])
        for old, new in places.items():
            arguments = [argument.replace(old, new) for argument in arguments]
        return arguments

    def kill(self) -> None:
        """End the process at once, as a crash would."""
        if self.process is not None:
            self.process.kill()
            self.process.wait(STOP_SECONDS_MAX)
            self.process = None

    def client(
        self,
        user: str | None = SETUP_USER,
        password: str = SETUP_PASSWORD,
        database: str = "admin",
        event_listeners: Sequence[Any] = (),
    ) -> pymongo.MongoClient[dict[str, Any]]:
        account: dict[str, Any] = {"username": user, "password": password, "authSource": database} if user else {}
        client: pymongo.MongoClient[dict[str, Any]] = pymongo.MongoClient(
            "127.0.0.1",
            self.port,
            serverSelectionTimeoutMS=5000,
            event_listeners=event_listeners,
            connect=False,
            **account,
        )
        if self.tls is not None:
            encrypt(client, self.tls)
        self.clients.append(client)
        return client

    def create_account(self, user: str, password: str, database: str) -> None:
        roles = [{"role": "readWrite", "db": database}]
        self.client()[database].command("createUser", user, pwd=password, roles=roles)

    def close(self) -> None:
        for client in self.clients:
            client.close()
        self.kill()

    def _listening(self) -> bool:
        try:
            socket.create_connection(("127.0.0.1", self.port), 1).close()
        except OSError:
            return False
        return True
