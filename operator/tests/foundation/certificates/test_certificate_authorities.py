"""Whom clients by HTTPS believe in one process: named before or after a context was made, and as the file is now."""

from __future__ import annotations

import ssl
import time
from pathlib import Path

import httpx
import pytest

from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters import certificate_authorities as authorities
from robotkube.foundation.certificates.adapters import issuing
from robotkube.foundation.certificates.core.lives import Pair
from tests.stages.handshakes import answering, server_context, written

NAME = "localhost"


@pytest.fixture(autouse=True)
def trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody, and what a test trusts goes with it."""
    monkeypatch.setattr(authorities, "_trusted", {})


def another(folder: Path) -> tuple[Pair, ssl.SSLContext]:
    """An authority, and what a server shows that it signed for."""
    authority = issuing.new_authority("ours", time.time())
    return authority, server_context(folder, issuing.issue(authority, [NAME], time.time(), 60))


def test_a_server_is_believed_from_when_its_authority_is_trusted(tmp_path: Path) -> None:
    authority, server = another(tmp_path / "server")
    with httpx.Client(verify=authorities.certificate_authorities()) as client, answering(server) as url:
        with pytest.raises(httpx.ConnectError) as met:
            client.get(url)
        words = "its certificate is of an authority that the list of authorities of this machine does not have; compare"
        assert authorities.what_failed(met.value, url).startswith(words)
        authorities.trust(written(tmp_path, authority))
        assert client.get(url).text == "yes"
        assert authorities.refusal_of(url) == ""


def test_another_authority_in_the_same_file_is_believed_without_another_client(tmp_path: Path) -> None:
    first, _ = another(tmp_path / "first")
    second, server = another(tmp_path / "second")
    file = written(tmp_path, first)
    authorities.trust(file)
    with httpx.Client(verify=authorities.certificate_authorities()) as client, answering(server) as url:
        with pytest.raises(httpx.ConnectError):
            client.get(url)
        assert f"authority that {file} does not have" in authorities.refusal_of(url)
        written(tmp_path, second)
        assert client.get(url).text == "yes"


def test_another_name_is_refused_with_what_to_do(tmp_path: Path) -> None:
    authority, server = another(tmp_path / "server")
    authorities.trust(written(tmp_path, authority))
    with answering(server) as url:
        words = authorities.refusal_of(url.replace(NAME, "127.0.0.1"))
    assert words.startswith("its certificate is not for the name 127.0.0.1; connect by one that it has, or add this")
    assert "forge.names" in words


def test_a_file_without_authorities_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.crt: no authority can be read there .*ConfigMap robotkube-ca"):
        authorities.trust(tmp_path / "none.crt")
    with pytest.raises(InputError, match=r"ca\.crt: no authority can be read there"):
        authorities.trust_text("no PEM")
    assert authorities.trusted() == ()


def test_authorities_that_stand_in_no_file_are_written_into_one_once() -> None:
    pem = issuing.new_authority("ours", time.time()).certificate
    authorities.trust_text(pem)
    authorities.trust_text(pem)
    [path] = authorities.trusted()
    assert path.read_text() == pem
