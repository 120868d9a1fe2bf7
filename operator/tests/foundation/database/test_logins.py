"""The account of the database in a mounted Secret, and of who reaches it from elsewhere: how it proves who it is."""

from __future__ import annotations

from pathlib import Path

import pytest

from robotkube.errors import DocumentError
from robotkube.foundation.certificates.adapters.verification import ServerVerification
from robotkube.foundation.database.adapters.connection import login_at, read_account

HOST = "database.robotkube.svc.cluster.local"
VALUES = {
    "username": "recordings_cloud_0",
    "password": "secret",
    "host": HOST,
    "port": "27018",
    "database": "recordings_cloud_0",
    "authenticationDatabase": "recordings_cloud_0",
    "tls": "required",
}


def mounted(folder: Path, **changes: str) -> Path:
    for name, text in {**VALUES, **changes}.items():
        if text:
            (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize(
    ("changes", "name"),
    [({}, HOST), ({"host": "10.0.0.9", "server_name": "suite-database"}, "suite-database")],
    ids=["platform", "test namespace"],
)
def test_encrypted_by_the_authorities_beside_it(tmp_path: Path, changes: dict[str, str], name: str) -> None:
    login = read_account(mounted(tmp_path, **changes))
    assert login.port == 27018
    assert login.tls == ServerVerification(tmp_path / "ca.crt", name)


@pytest.mark.parametrize("tls", ["off", ""], ids=["off", "of an earlier chart"])
def test_in_clear_text_when_the_account_says_so(tmp_path: Path, tls: str) -> None:
    assert read_account(mounted(tmp_path, tls=tls)).tls is None


def test_every_problem_of_an_account_is_named(tmp_path: Path) -> None:
    with pytest.raises(DocumentError) as refused:
        read_account(mounted(tmp_path, tls="maybe", username=""))
    [username, tls] = refused.value.problems
    assert username.startswith("username: ")
    assert "'maybe'; must be required or off" in tls


def test_from_elsewhere_the_certificate_is_for_the_host_of_the_account(tmp_path: Path) -> None:
    login = login_at(("10.96.0.7", 27018), VALUES, "PEM", tmp_path)
    assert (login.host, login.tls) == ("10.96.0.7", ServerVerification(tmp_path / "ca.crt", HOST))
    assert (tmp_path / "ca.crt").read_text() == "PEM"
    assert login_at(("10.96.0.7", 27017), {**VALUES, "tls": "off"}, "", tmp_path).tls is None
    with pytest.raises(DocumentError, match="has no key 'database'"):
        login_at(("10.96.0.7", 27018), {key: VALUES[key] for key in ("host", "tls")}, "PEM", tmp_path)
