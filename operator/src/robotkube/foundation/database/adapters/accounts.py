"""Accounts of the database (MongoDB or FerretDB), made by its administrator."""

from __future__ import annotations

from typing import Any

from pymongo import MongoClient
from pymongo.errors import ConnectionFailure, OperationFailure, PyMongoError

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.adapters.verification import ServerVerification
from robotkube.foundation.database.adapters.encryption import encrypt

TIMEOUT_MILLISECONDS = 5_000
AUTHENTICATION_FAILED = 18


class MongoAccounts:
    """The port DatabaseAdministration; the administrator's account is kept in database `admin`. `tls`: how the database
    proves who it is; None: connections are in clear text."""

    def __init__(
        self, host: str, port: int, username: str, password: str, tls: ServerVerification | None = None
    ) -> None:
        self._where = f"database {host}:{port}"
        self._tls = tls
        self._address = (host, port)
        self._administrator = self._connect("admin", username, password)

    def _connect(self, database: str, username: str, password: str) -> MongoClient[dict[str, Any]]:
        host, port = self._address
        client: MongoClient[dict[str, Any]] = MongoClient(
            host, port, username=username, password=password, authSource=database,
            serverSelectionTimeoutMS=TIMEOUT_MILLISECONDS, connectTimeoutMS=TIMEOUT_MILLISECONDS,
            socketTimeoutMS=TIMEOUT_MILLISECONDS, retryWrites=False, directConnection=True, connect=False,
        )  # fmt: skip
        if self._tls is not None:
            encrypt(client, self._tls)
        return client

    def disconnect(self) -> None:
        """Close the connections."""
        self._administrator.close()

    def answers(self) -> bool:
        """Check that the database serves and accepts the administrator's password: then False, nothing was changed;
        UnavailableError before."""
        try:
            self._administrator["admin"].command("usersInfo", 1)
        except PyMongoError as error:
            raise UnavailableError(f"{self._where}: {error}") from error
        return False

    def make_account(self, database: str, username: str, password: str) -> bool:
        """Make an account of `database` with readWrite on it and nothing else, or set what differs; whether something
        was changed."""
        roles = [{"role": "readWrite", "db": database}]
        account: dict[str, Any] = {"pwd": password, "roles": roles}
        try:
            users = self._administrator[database].command("usersInfo", {"user": username, "db": database})["users"]
            if not users:
                self._administrator[database].command("createUser", username, **account)
                return True
            if users[0].get("roles") == roles and self._knows(database, username, password):
                return False
            self._administrator[database].command("updateUser", username, **account)
        except ConnectionFailure as error:
            raise UnavailableError(f"{self._where}: account {username}: {error}") from error
        except PyMongoError as error:
            raise InputError(f"{self._where}: account {username} of {database}: {error}") from error
        return True

    def _knows(self, database: str, username: str, password: str) -> bool:
        client = self._connect(database, username, password)
        try:
            client[database].command("ping")
            client[database].list_collection_names()
        except OperationFailure as error:
            if error.code == AUTHENTICATION_FAILED:
                return False
            raise
        finally:
            client.close()
        return True
