"""A connection to the database by pymongo: account, options, and its errors as ours. An account is read from the files
of the Secret `database-account`; how the database proves who it is: foundation.certificates.adapters.account_files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bson.codec_options import CodecOptions, TypeDecoder, TypeRegistry
from bson.errors import BSONError
from bson.int64 import Int64
from pymongo import MongoClient
from pymongo.database import Database
from pymongo.errors import DocumentTooLarge, PyMongoError

from robotkube.errors import DocumentError, InputError, UnavailableError
from robotkube.foundation.certificates.adapters.account_files import AUTHORITIES, REQUIRED, TLS, read_verification
from robotkube.foundation.certificates.adapters.verification import ServerVerification
from robotkube.foundation.database.adapters.encryption import encrypt

ANSWER_SECONDS_MAX = 5.0
_ACCOUNT_KEYS = ("username", "password", "host", "port", "database", "authenticationDatabase")


@dataclass(frozen=True)
class DatabaseLogin:
    """The address of the database and an account of it. `authentication_database`: the one that knows the account.
    `tls` None: the connection is in clear text."""

    host: str
    port: int
    database: str
    username: str
    password: str
    authentication_database: str
    tls: ServerVerification | None = None


def read_account(folder: Path) -> DatabaseLogin:
    """Read the mounted Secret `database-account`; DocumentError names the missing or wrong file."""
    values = {}
    problems = []
    for key in _ACCOUNT_KEYS:
        try:
            values[key] = (folder / key).read_text().strip()
        except OSError as error:
            problems.append(f"{key}: {error.strerror}; is the Secret mounted there?")
    if not problems and not values["port"].isdigit():
        problems.append("port: must be a number")
    tls = None
    try:
        tls = read_verification(folder, values.get("host", ""))
    except InputError as error:
        problems.append(str(error))
    if problems:
        raise DocumentError(str(folder), problems)
    return DatabaseLogin(
        host=values["host"],
        port=int(values["port"]),
        database=values["database"],
        username=values["username"],
        password=values["password"],
        authentication_database=values["authenticationDatabase"],
        tls=tls,
    )


def login_at(address: tuple[str, int], values: Mapping[str, str], authorities: str, folder: Path) -> DatabaseLogin:
    """The account in the `values` of a Secret `database-account`, for who reaches the database at another address than
    pods do: its certificate is for the Secret's host, of the authorities (PEM), which are written into `folder`.
    DocumentError names the missing key."""
    try:
        tls = ServerVerification(folder / AUTHORITIES, values["host"]) if values.get(TLS) == REQUIRED else None
        database, username, password = values["database"], values["username"], values["password"]
        login = DatabaseLogin(*address, database, username, password, values["authenticationDatabase"], tls)
    except KeyError as error:
        raise DocumentError("secret database-account", [f"has no key {error}"]) from error
    if tls is not None:
        tls.authorities.write_text(authorities)
    return login


class _PlainInteger(TypeDecoder):
    """A decoder of long integers to int: the library's own kind is one that others, such as YAML, do not write."""

    bson_type = Int64

    def transform_bson(self, value: Any) -> int:
        """The int."""
        return int(value)


@contextmanager
def translated(doing: str) -> Iterator[None]:
    """Translate the library's errors in the block into this package's; `doing` is what the block does."""
    try:
        yield
    except (DocumentTooLarge, BSONError) as error:
        raise DocumentError(f"database, {doing}", [str(error)[:500]]) from error
    except PyMongoError as error:
        text = " ".join(str(error).partition(", Topology Description")[0].split())
        raise UnavailableError(f"database, {doing}: {text[:500]}") from error


def connect(account: DatabaseLogin, answer_seconds_max: float = ANSWER_SECONDS_MAX) -> Database[dict[str, Any]]:
    """The account's database; nothing is sent yet."""
    client: MongoClient[dict[str, Any]] = MongoClient(
        account.host,
        account.port,
        username=account.username,
        password=account.password,
        authSource=account.authentication_database,
        appname="robotkube",
        serverSelectionTimeoutMS=int(answer_seconds_max * 1000),
        connectTimeoutMS=int(answer_seconds_max * 1000),
        socketTimeoutMS=int(answer_seconds_max * 1000),
        maxPoolSize=2,
        retryWrites=False,  # every write may be done twice anyway
        journal=True,  # acknowledged means on the disk
        connect=False,
    )
    if account.tls is not None:
        encrypt(client, account.tls)
    options: CodecOptions[dict[str, Any]] = CodecOptions(type_registry=TypeRegistry([_PlainInteger()]))
    return client.get_database(account.database, codec_options=options)
