# ruff: noqa: S106 - a password of an account that must not come to be
"""The database inside the cluster: nobody without an account, and each account only its own data. Wrong accounts:
foundation/database/test_accounts.py."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pymongo
import pytest
from pymongo.errors import OperationFailure

from robotkube.foundation.database.adapters.encryption import encrypt
from tests.stages.platform.running_platform import Platform

UNAUTHORIZED = 13
ANSWER_MILLISECONDS_MAX = 10_000
Client = pymongo.MongoClient[dict[str, Any]]


class Accounts:
    """Clients of the cluster's database by account."""

    def __init__(self, platform: Platform, folder: Path) -> None:
        self.own = platform.access.secret("cloud-0", "database-account")
        self._login = platform.access.database_account("cloud-0", folder)
        self._clients: list[Client] = []

    def client(self, **account: str) -> Client:
        """A client as the given account, or as nobody."""
        where = (self._login.host, self._login.port)
        client = Client(*where, serverSelectionTimeoutMS=ANSWER_MILLISECONDS_MAX, connect=False, **account)
        assert self._login.tls is not None
        encrypt(client, self._login.tls)
        self._clients.append(client)
        return client

    def recorder(self, **changes: str) -> Client:
        """The recorder's account of cloud-0, with changes."""
        account = {key: self.own[key] for key in ("username", "password")}
        return self.client(**{**account, "authSource": self.own["authenticationDatabase"], **changes})

    def close(self) -> None:
        """Ends all connections."""
        for client in self._clients:
            client.close()


@pytest.fixture
def accounts(platform: Platform, tmp_path: Path) -> Iterator[Accounts]:
    with_logins = Accounts(platform, tmp_path)
    yield with_logins
    with_logins.close()


def test_the_recorder_reads_and_writes_its_own_database(accounts: Accounts) -> None:
    own = accounts.recorder()[accounts.own["database"]]["probe"]
    own.insert_one({"_id": "probe"})
    assert own.find_one() == {"_id": "probe"}
    own.drop()


def test_nobody_without_an_account(accounts: Accounts) -> None:
    database = accounts.client()[accounts.own["database"]]
    assert refused(lambda: database["samples"].find_one()) == UNAUTHORIZED
    assert refused(lambda: database["samples"].insert_one({})) == UNAUTHORIZED


@pytest.mark.parametrize("other", ["recordings_vehicle_00", "admin"])
def test_the_recorder_has_no_other_database(accounts: Accounts, other: str) -> None:
    database = accounts.recorder()[other]
    assert refused(lambda: database["samples"].find_one()) == UNAUTHORIZED
    assert refused(lambda: database["samples"].insert_one({})) == UNAUTHORIZED
    assert refused(lambda: database.command("createUser", "more", pwd="password", roles=[])) == UNAUTHORIZED


def refused(call: Any) -> int | None:
    """The code with which the database refuses a call."""
    with pytest.raises(OperationFailure) as caught:
        call()
    return caught.value.code
