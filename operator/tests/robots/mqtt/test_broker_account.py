"""The account in the mounted files: its address, and how broker and account prove who they are."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.issuing import new_authority
from robotkube.foundation.certificates.adapters.verification import ClientCertificate, ServerVerification
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount, read_broker_account

FILES = {"host": "broker.robotkube.svc", "port": "8883", "username": "vehicle-00", "password": "secret"}


def mounted(folder: Path, **more: str) -> Path:
    for name, text in {**FILES, **more}.items():
        (folder / name).write_text(text + "\n")
    return folder


@pytest.mark.parametrize("more", [{}, {"tls": "off"}], ids=["of before there was TLS", "off"])
def test_in_clear_text(tmp_path: Path, more: dict[str, str]) -> None:
    account = BrokerAccount("broker.robotkube.svc", 8883, "vehicle-00", "secret")
    assert read_broker_account(mounted(tmp_path, **more)) == account


@pytest.mark.parametrize(("more", "name"), [({}, "broker.robotkube.svc"), ({"server_name": "suite"}, "suite")])
def test_encrypted_by_the_authorities_beside_it(tmp_path: Path, more: dict[str, str], name: str) -> None:
    account = read_broker_account(mounted(tmp_path, tls="required", **more))
    assert account.tls == ServerVerification(tmp_path / "ca.crt", name)


@pytest.mark.parametrize(("key", "value"), [("port", "x"), ("tls", "maybe"), ("tls", "")])
def test_what_is_wrong_is_named_by_its_file(tmp_path: Path, key: str, value: str) -> None:
    with pytest.raises(InputError, match=f"{tmp_path / key}: '{value}'"):
        read_broker_account(mounted(tmp_path, **{key: value}))


def test_a_certificate_proves_it_and_its_password_is_sent_to_nobody(tmp_path: Path) -> None:
    account = read_broker_account(mounted(tmp_path, tls="required", identity="certificate"))
    assert account.certificate == ClientCertificate(tmp_path)
    assert account.login is None
    by_password = read_broker_account(mounted(tmp_path, tls="required", identity="password"))
    assert (by_password.certificate, by_password.login) == (None, ("vehicle-00", "secret"))


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"tls": "required", "identity": "key"}, "identity: 'key'; must be certificate or password"),
        ({"tls": "off", "identity": "certificate"}, "tls: must be required, since "),
        ({"identity": "certificate"}, "tls: must be required, since "),
    ],
)
def test_a_certificate_without_tls_is_refused(tmp_path: Path, more: dict[str, str], said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_broker_account(mounted(tmp_path, **more))


def test_files_that_are_not_there_yet_are_named(tmp_path: Path) -> None:
    (tmp_path / "ca.crt").write_text(new_authority("ours", time.time()).certificate)
    account = read_broker_account(mounted(tmp_path, tls="required", identity="certificate"))
    with pytest.raises(InputError, match=f"{tmp_path}: no certificate of this account can be read in tls.crt"):
        account.context()
