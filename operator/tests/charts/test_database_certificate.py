"""The database as the chart starts it in the embedded profile, on a real FerretDB: who is refused and in what words,
and that a renewed certificate is shown without a restart and without a lost document."""

from __future__ import annotations

import os
import socket
import ssl
import subprocess
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from robotkube.errors import UnavailableError
from robotkube.foundation.certificates.adapters.issuing import issue, new_authority
from robotkube.foundation.certificates.adapters.verification import ServerVerification
from robotkube.foundation.certificates.core.lives import Pair
from robotkube.foundation.database.adapters.accounts import MongoAccounts
from robotkube.foundation.database.adapters.connection import DatabaseLogin, connect, translated
from tests.stages.paths import CHARTS
from tests.stages.programs import free_port, program
from tests.stages.waiting import WAIT_SECONDS_MAX, until

pytestmark = pytest.mark.toolchain

PLATFORM = CHARTS / "robotkube"
EMBEDDED = (PLATFORM / "values-embedded.yaml", Path(__file__).parent / "profiles" / "embedded.yaml")
NAME = "database.robotkube.svc.cluster.local"
DATABASE = "recordings_cloud_0"
ANSWER_SECONDS = 1.0  # for what is refused: it is tried again until then
WRITE_SECONDS_MAX = 20.0  # for what is taken: a machine that is full may let it wait
RENEWALS, DOCUMENTS = 4, 40


@dataclass
class EncryptedDatabase:
    """The container of the database's pod, as a process with the arguments that the chart renders, on its files."""

    folder: Path
    arguments: list[str]
    port: int = field(default_factory=free_port)
    authority: Pair = field(default_factory=lambda: new_authority("ours", time.time()))

    def start(self) -> None:
        (self.folder / "data").mkdir(parents=True)
        (self.folder / "ca.crt").write_text(self.authority.certificate)
        self.show(3600)
        places = {"/data/db": str(self.folder / "data"), "/etc/database-tls": str(self.folder)}
        places |= {":27018": f"127.0.0.1:{self.port}"}
        arguments = self.arguments
        for old, new in places.items():
            arguments = [argument.replace(old, new) for argument in arguments]
        accounts = {"FERRETDB_SETUP_USERNAME": "administrator", "FERRETDB_SETUP_PASSWORD": "first"}
        with (self.folder / "log").open("ab") as sink:
            self.process = subprocess.Popen(
                [program("ferretdb"), *arguments], env={**os.environ, **accounts}, stdout=sink, stderr=sink
            )
        until(self.answers, "the database", state=lambda: (self.folder / "log").read_text())

    def answers(self) -> bool:
        try:
            return bool(self.shown())
        except OSError:
            return False

    def show(self, seconds: float, began: float = 0.0, authority: Pair | None = None) -> None:
        """Another certificate in the mounted files, both at once as a kubelet does it."""
        pair = issue(authority or self.authority, [NAME, "database"], time.time() - began, seconds)
        for name, text in (("tls.key", pair.key), ("tls.crt", pair.certificate)):
            (self.folder / f"{name}.new").write_text(text)
        for name in ("tls.key", "tls.crt"):
            (self.folder / f"{name}.new").replace(self.folder / name)

    def shown(self) -> bytes:
        """The certificate that a client sees now, valid or not."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
        with socket.create_connection(("127.0.0.1", self.port), 5) as plain, context.wrap_socket(plain) as encrypted:
            return encrypted.getpeercert(binary_form=True) or b""

    def renewed(self) -> Callable[[], bool]:
        """Show another one; whether the database does."""
        before = self.shown()
        self.show(3600)
        return lambda: self.shown() != before

    def login(self, name: str = NAME, authorities: Path | None = None) -> DatabaseLogin:
        tls = ServerVerification(authorities or self.folder / "ca.crt", name)
        return DatabaseLogin("127.0.0.1", self.port, DATABASE, DATABASE, "secret", DATABASE, tls)

    def stop(self) -> None:
        self.process.kill()
        self.process.wait(WAIT_SECONDS_MAX)


@pytest.fixture
def database(helm: Any, tmp_path: Path) -> Iterator[EncryptedDatabase]:
    [container] = dict(helm.template(PLATFORM, *EMBEDDED).pods)["StatefulSet/database"]["containers"]
    running = EncryptedDatabase(tmp_path / "database", container["args"])
    try:
        running.start()
        verification = running.login().tls
        accounts = MongoAccounts("127.0.0.1", running.port, "administrator", "first", verification)
        accounts.make_account(DATABASE, DATABASE, "secret")
        assert not accounts.make_account(DATABASE, DATABASE, "secret")
        accounts.disconnect()
        yield running
    finally:
        running.stop()


def complaint(login: DatabaseLogin) -> str:
    """What somebody says who cannot connect."""
    store = connect(login, ANSWER_SECONDS)
    try:
        with pytest.raises(UnavailableError) as error, translated("looking"):
            store["samples"].find_one()
    finally:
        store.client.close()
    return str(error.value)


def test_who_is_refused_says_why(database: EncryptedDatabase) -> None:
    other = database.folder / "other.crt"
    missing = database.folder / "none.crt"
    clear = database.login()
    other.write_text(new_authority("another", time.time()).certificate)
    refused = {
        f"its certificate is of an authority that {other} does not have": database.login(authorities=other),
        "its certificate is not for the name broker": database.login("broker"),
        f"{missing}: no authority can be read there": database.login(authorities=missing),
        "database": DatabaseLogin(clear.host, clear.port, DATABASE, DATABASE, "secret", DATABASE),
    }
    with ThreadPoolExecutor() as lanes:  # each tries until its time is over
        for words, said in zip(refused, lanes.map(complaint, refused.values()), strict=True):
            assert words in said
    database.show(60, began=3600)
    until(lambda: "its certificate has expired" in complaint(database.login()), "the expired certificate")


def test_a_renewal_ends_no_connection_and_loses_no_document(database: EncryptedDatabase) -> None:
    writing = connect(database.login(), WRITE_SECONDS_MAX)
    try:
        for renewal in range(RENEWALS):
            renewed = database.renewed()
            for number in range(DOCUMENTS):
                writing["samples"].insert_one({"_id": f"{renewal}/{number}"})
            until(renewed, "the renewed certificate")
            fresh = connect(database.login(), WRITE_SECONDS_MAX)
            assert fresh["samples"].count_documents({}) == (renewal + 1) * DOCUMENTS
            fresh.client.close()
    finally:
        writing.client.close()
    assert database.process.poll() is None


def test_half_a_renewal_leaves_the_certificate_that_was_there(database: EncryptedDatabase) -> None:
    before = database.shown()
    (database.folder / "tls.key").write_text("half")
    (database.folder / "tls.crt").write_text("half")
    assert database.shown() == before
    until(database.renewed(), "the renewed certificate")
