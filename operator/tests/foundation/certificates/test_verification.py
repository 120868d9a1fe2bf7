"""Certificates that are made here, and a client that takes them or says why not; handshakes between two ends in this
process."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters import issuing
from robotkube.foundation.certificates.adapters.verification import ServerVerification, client_context, sentence
from robotkube.foundation.certificates.core.lives import Pair, reason_to_replace
from tests.stages.handshakes import handshake, server_context, written

NAME = "broker.robotkube.svc.cluster.local"
NAMES = [NAME, "broker", "192.0.2.7"]


@pytest.fixture(scope="module")
def authority() -> Pair:
    return issuing.new_authority("ours", time.time())


def refused(folder: Path, shown: Pair | None, trusted: Pair, name: str = NAME) -> str:
    """What the client says of a server that shows this certificate; None: it answers in clear text."""
    verification = ServerVerification(written(folder / "client", trusted), name)
    context = server_context(folder / "server", shown) if shown is not None else None
    with pytest.raises(OSError, match=r".") as met:
        handshake(context, verification)
    return sentence(met.value, verification)


@pytest.mark.parametrize("name", NAMES)
def test_a_certificate_of_the_authority_is_taken_for_each_of_its_names(
    authority: Pair, tmp_path: Path, name: str
) -> None:
    now = time.time()
    certificate = issuing.issue(authority, NAMES, now, 3600)
    server = server_context(tmp_path / "server", certificate)
    assert handshake(server, ServerVerification(written(tmp_path, authority), name)) == "TLSv1.3"
    life = issuing.describe(certificate, authority)
    assert reason_to_replace(life, NAMES, now) == ""
    assert 3599 <= life.end - now <= 3600


def test_another_name_is_refused(authority: Pair, tmp_path: Path) -> None:
    said = refused(tmp_path, issuing.issue(authority, NAMES, time.time(), 60), authority, "forge.robotkube")
    assert said == (
        "its certificate is not for the name forge.robotkube; connect by one that it has, or add this one to tls.names "
        "(of the forge: forge.names)"
    )


def test_one_of_another_authority_is_refused_by_the_file_that_does_not_have_it(authority: Pair, tmp_path: Path) -> None:
    other = issuing.new_authority("ours", time.time())
    certificate = issuing.issue(other, NAMES, time.time(), 60)
    said = refused(tmp_path, certificate, authority)
    assert said.startswith(f"its certificate is of an authority that {tmp_path}/client/ca.crt does not have")
    assert not issuing.describe(certificate, authority).signed


def test_one_that_has_expired_is_refused(authority: Pair, tmp_path: Path) -> None:
    said = refused(tmp_path, issuing.issue(authority, NAMES, time.time() - 120, 60), authority)
    assert said.startswith("its certificate has expired; have it renewed")


def test_one_that_is_not_valid_yet_is_refused(authority: Pair, tmp_path: Path) -> None:
    said = refused(tmp_path, issuing.issue(authority, NAMES, time.time() + 3600, 60), authority)
    assert said == "its certificate is not valid yet; compare the clocks"


def test_a_certificate_that_is_no_authoritys_signs_nothing(authority: Pair, tmp_path: Path) -> None:
    """A broker that was taken over makes no other one."""
    broker = issuing.issue(authority, NAMES, time.time(), 60)
    forged = issuing.issue(broker, NAMES, time.time(), 60)
    chain = Pair(forged.certificate + broker.certificate, forged.key)
    assert "its certificate does not hold" in refused(tmp_path, chain, authority)
    assert issuing.is_authority(authority)
    assert not issuing.is_authority(broker)


def test_a_server_in_clear_text_is_named_as_such(authority: Pair, tmp_path: Path) -> None:
    assert refused(tmp_path, None, authority).startswith("it does not speak TLS at this port")


def test_a_certificate_lives_no_longer_than_its_authority() -> None:
    now = time.time()
    short = issuing.new_authority("short", now, 100)
    assert issuing.describe(issuing.issue(short, NAMES, now, 3600), short).end <= now + 100


def test_one_that_is_thrown_away_is_of_an_authority_of_its_own(tmp_path: Path) -> None:
    issued = issuing.throw_away("suite-broker")
    (tmp_path / "ca.crt").write_text(issued.authority)
    server = server_context(tmp_path / "server", issued.pair)
    assert handshake(server, ServerVerification(tmp_path / "ca.crt", "suite-broker")) == "TLSv1.3"
    assert issuing.throw_away("suite-broker").authority != issued.authority


@pytest.mark.parametrize("text", [None, "", "no PEM"])
def test_a_file_without_authorities_is_named_with_where_it_comes_from(tmp_path: Path, text: str | None) -> None:
    path = tmp_path / "ca.crt"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=rf"{path}: no authority can be read there .*ConfigMap robotkube-ca"):
        client_context(ServerVerification(path, NAME))


@pytest.mark.parametrize("pair", [Pair("", ""), Pair("x", "y")])
def test_what_is_no_certificate_is_said(authority: Pair, pair: Pair) -> None:
    with pytest.raises(InputError, match="cannot be read as PEM"):
        issuing.describe(pair, authority)
