"""The account in the mounted files: its address, and how the broker proves who it is."""

from __future__ import annotations

from pathlib import Path

import pytest

from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.verification import ServerVerification
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
