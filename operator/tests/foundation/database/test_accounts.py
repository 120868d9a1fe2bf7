# ruff: noqa: S106 - passwords of accounts that live as long as a test
"""Accounts of the embedded profile's database: who may do what, over pymongo on a real process.

The calls are those the platform's set-up makes on a MongoDB server too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pymongo
import pytest
from pymongo.errors import OperationFailure

from tests.stages.recording.database_server import DatabaseServer

pytestmark = pytest.mark.toolchain

OWN, OTHER = "recordings_cloud_0", "recordings_edge_0"
UNAUTHORIZED, AUTHENTICATION_FAILED, BAD_VALUE = 13, 18, 2
Database = pymongo.database.Database[dict[str, Any]]


@pytest.fixture
def own(database_server: Any) -> Database:
    """The recorder's own database, with a document in it and one in another's."""
    return filled(database_server)


def filled(server: DatabaseServer) -> Database:
    server.create_account("recorder", "secret", OWN)
    server.client()[OTHER]["samples"].insert_one({"_id": "theirs"})
    database: Database = server.client("recorder", "secret", OWN)[OWN]
    database["samples"].insert_one({"_id": "mine"})
    return database


@pytest.fixture(scope="module")
def refusing_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DatabaseServer]:
    """One for all tests of what is refused, which leaves nothing behind."""
    server = DatabaseServer(tmp_path_factory.mktemp("database") / "server")
    server.start()
    yield server
    server.close()


@pytest.fixture(scope="module")
def filled_once(refusing_server: DatabaseServer) -> Database:
    return filled(refusing_server)


@pytest.fixture
def kept(refusing_server: DatabaseServer, filled_once: Database) -> Iterator[Database]:
    """The same as `own`, and everything in it is there afterwards, for its account."""
    yield filled_once
    assert filled_once["samples"].find_one() == {"_id": "mine"}
    root = refusing_server.client()
    assert {name: list(root[name]["samples"].find()) for name in (OWN, OTHER)} == {
        OWN: [{"_id": "mine"}],
        OTHER: [{"_id": "theirs"}],
    }


def refused(call: Callable[[], object]) -> int | None:
    with pytest.raises(OperationFailure) as caught:
        call()
    return caught.value.code


def test_no_account_is_refused(database_server: Any) -> None:
    client = database_server.client(user=None)
    assert client.admin.command("ping")["ok"] == 1.0
    assert refused(lambda: client[OWN]["samples"].find_one()) == UNAUTHORIZED
    assert refused(lambda: client[OWN]["samples"].insert_one({})) == UNAUTHORIZED


def test_wrong_password_and_unknown_account_are_refused(database_server: Any) -> None:
    database_server.create_account("recorder", "secret", OWN)
    for user, password, database in [
        ("recorder", "wrong", OWN), ("nobody", "secret", OWN), ("recorder", "secret", OTHER)
    ]:  # fmt: skip
        samples = database_server.client(user, password, database)[OWN]["samples"]
        assert refused(samples.find_one) == AUTHENTICATION_FAILED


def test_account_uses_its_own_database(own: Database) -> None:
    own["samples"].insert_many([{"_id": i} for i in range(300)])
    own["samples"].create_index("recording")
    own["samples"].update_one({"_id": 1}, {"$set": {"n": 1}})
    own["samples"].delete_one({"_id": 2})
    assert own["samples"].count_documents({}) == 300
    assert len(list(own["samples"].find(batch_size=50))) == 300
    assert own.list_collection_names() == ["samples"]


@pytest.mark.parametrize("database", [OTHER, "admin", "local", "config", "neverseen"])
def test_account_is_refused_on_another_database(kept: Database, database: str) -> None:
    theirs = kept.client[database]
    for call in (
        lambda: theirs["samples"].find_one(),
        lambda: theirs["samples"].count_documents({}),
        lambda: theirs["samples"].insert_one({}),
        lambda: theirs["samples"].delete_many({}),
        lambda: theirs["samples"].drop(),
        lambda: theirs["system.users"].find_one(),
        lambda: theirs.list_collection_names(),
        lambda: theirs.command("dropDatabase"),
    ):
        assert refused(call) == UNAUTHORIZED


@pytest.mark.parametrize(
    "command",
    [
        {"renameCollection": f"{OTHER}.samples", "to": f"{OTHER}.stolen"},
        {"dataSize": f"{OTHER}.samples"},
        {"createUser": "more", "pwd": "x", "roles": [{"role": "root", "db": "admin"}]},
        {"updateUser": "recorder", "roles": [{"role": "root", "db": "admin"}]},
        {"dropUser": "recorder"},
        {"usersInfo": 1},
        {"dropAllUsersFromDatabase": 1},
        {"dropDatabase": 1},
        {"getLog": "global"},
        {"serverStatus": 1},
        {"listDatabases": 1},
    ],
    ids=lambda command: next(iter(command)),
)
def test_commands_that_reach_further_than_their_database_need_root(kept: Database, command: dict[str, Any]) -> None:
    assert refused(lambda: kept.command(command)) == UNAUTHORIZED


def test_getmore_on_a_foreign_cursor_is_refused(own: Database, database_server: Any) -> None:
    root = database_server.client()[OTHER]
    root["samples"].insert_many([{"n": n} for n in range(20)])
    cursor = root.command("find", "samples", batchSize=2)["cursor"]["id"]
    command = {"getMore": cursor, "collection": "samples"}
    assert refused(lambda: own.client[OTHER].command(command)) == UNAUTHORIZED
    assert refused(lambda: own.command(command)) is not None


def test_a_reading_account_cannot_write(database_server: Any) -> None:
    database_server.client()[OWN].command("createUser", "reader", pwd="x", roles=["read"])
    database = database_server.client("reader", "x", OWN)[OWN]
    assert database["samples"].find_one() is None
    assert refused(lambda: database["samples"].insert_one({})) == UNAUTHORIZED


@pytest.mark.parametrize(
    "roles", [["dbOwner"], [{"role": "readWrite", "db": "admin"}], ["root"], [{"role": "readWrite"}], [1]]
)
def test_unsupported_roles_are_refused_when_given(refusing_server: DatabaseServer, roles: list[Any]) -> None:
    assert refused(lambda: refusing_server.client()[OWN].command("createUser", "a", pwd="x", roles=roles)) == BAD_VALUE


def test_an_account_without_roles_may_nothing(database_server: Any) -> None:
    database_server.client()[OWN].command("createUser", "nobody", pwd="x", roles=[])
    assert refused(lambda: database_server.client("nobody", "x", OWN)[OWN]["samples"].find_one()) == UNAUTHORIZED


def test_password_change_and_removal_take_effect(own: Database, database_server: Any) -> None:
    database_server.client()[OWN].command("updateUser", "recorder", pwd="new")
    old = database_server.client("recorder", "secret", OWN)
    assert refused(lambda: old[OWN]["samples"].find_one()) == AUTHENTICATION_FAILED
    assert database_server.client("recorder", "new", OWN)[OWN]["samples"].count_documents({}) == 1
    database_server.client()[OWN].command("dropUser", "recorder")
    assert refused(lambda: own["samples"].find_one()) == UNAUTHORIZED  # the connection was open before


def test_accounts_and_data_outlive_a_killed_server(own: Database, database_server: Any) -> None:
    database_server.kill()
    database_server.start()
    fresh = database_server.client("recorder", "secret", OWN)[OWN]
    assert fresh["samples"].count_documents({}) == 1
    assert refused(lambda: database_server.client(user=None)[OWN]["samples"].find_one()) == UNAUTHORIZED
    database_server.create_account("second", "x", OWN)
