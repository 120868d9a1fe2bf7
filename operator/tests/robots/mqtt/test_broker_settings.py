"""The key `broker` in settings of the platform's processes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from robotkube.errors import DocumentError
from robotkube.foundation.certificates.adapters.verification import ClientCertificate, ServerVerification
from robotkube.foundation.documents.core.reader import Reader
from robotkube.robots.mqtt.broker_settings import read_broker

AUTHORITIES = "/etc/robotkube/authorities/ca.crt"


def broker(folder: Path, **more: Any) -> dict[str, Any]:
    (folder / "username").write_text("manager")
    (folder / "password").write_text("secret")
    return {"host": "broker.robotkube", "port": 8883, "credentials": str(folder), **more}


@pytest.mark.parametrize(
    ("more", "tls"),
    [({}, None), ({"authorities": AUTHORITIES}, ServerVerification(Path(AUTHORITIES), "broker.robotkube"))],
)
def test_with_authorities_the_broker_has_to_prove_its_host(
    tmp_path: Path, more: dict[str, Any], tls: ServerVerification | None
) -> None:
    reader = Reader("config.yaml")
    account = read_broker(reader, broker(tmp_path, **more))
    reader.finish()
    assert (account.host, account.port, account.username, account.password) == (
        "broker.robotkube",
        8883,
        "manager",
        "secret",
    )
    assert account.tls == tls


@pytest.mark.parametrize("more", [{"port": 0}, {"port": "8883"}, {"port": True}, {"authorities": "ca.crt"}, {"tls": 1}])
def test_what_is_wrong_is_named(tmp_path: Path, more: dict[str, Any]) -> None:
    reader = Reader("config.yaml")
    read_broker(reader, broker(tmp_path, **more))
    with pytest.raises(DocumentError, match=f"broker.{next(iter(more))}"):
        reader.finish()


def test_a_certificate_in_the_folder_proves_the_account(tmp_path: Path) -> None:
    (tmp_path / "identity").write_text("certificate\n")
    reader = Reader("config.yaml")
    account = read_broker(reader, broker(tmp_path, authorities=AUTHORITIES))
    reader.finish()
    assert (account.certificate, account.login) == (ClientCertificate(tmp_path), None)


@pytest.mark.parametrize(
    ("identity", "more", "said"),
    [
        ("certificate", {}, "broker.authorities: is missing, but a certificate proves the account"),
        ("key", {"authorities": AUTHORITIES}, "broker.credentials: .*identity: 'key'; must be certificate or password"),
    ],
)
def test_what_proves_nothing_is_named(tmp_path: Path, identity: str, more: dict[str, Any], said: str) -> None:
    (tmp_path / "identity").write_text(identity)
    reader = Reader("config.yaml")
    read_broker(reader, broker(tmp_path, **more))
    with pytest.raises(DocumentError, match=said):
        reader.finish()
