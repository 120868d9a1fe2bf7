"""Signing and verifying with real keys: what is taken, what is refused and with which words."""

from __future__ import annotations

import base64
import datetime
import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
)
from securesystemslib.dsse import Envelope

from robotkube.errors import InputError
from robotkube.foundation.documents.core.digests import canonical_json, sha256
from robotkube.registry.evidence.adapters.dsse import ENVELOPE_BYTES_MAX, KEYS_MAX, KeyFile, TrustedKeys
from robotkube.registry.evidence.core.statements import ENVELOPE_MEDIA_TYPE, suite_statement
from tests.stages.paths import DOCS
from tests.stages.registry.signed_evidence import POLICY, Signing, artefact, result, signing_key, trusting

APP = artefact()
STATEMENT = suite_statement(APP, POLICY.digest, result(POLICY.suites[0]))


@pytest.fixture
def key(tmp_path: Path) -> KeyFile:
    return signing_key(tmp_path / "gate")


@pytest.fixture
def trusted(tmp_path: Path, key: KeyFile) -> TrustedKeys:
    return trusting(tmp_path / "keys", key)


def refusal(trusted: TrustedKeys, data: bytes) -> str:
    with pytest.raises(InputError) as caught:
        trusted.verify(data)
    return str(caught.value)


def edited(data: bytes, change: Callable[[dict[str, Any]], None]) -> bytes:
    document = json.loads(data)
    change(document)
    return canonical_json(document)


def signed_anyway(key: KeyFile, payload: bytes, payload_type: str = ENVELOPE_MEDIA_TYPE) -> bytes:
    """A valid signature over whatever bytes."""
    envelope = Envelope(payload, payload_type, {})
    envelope.sign(key._signer)
    return canonical_json(envelope.to_dict())


def test_what_was_signed_is_read_back_with_digest_and_key(key: KeyFile, trusted: TrustedKeys) -> None:
    data = key.sign(STATEMENT)
    verified = trusted.verify(data)
    assert (verified.statement, verified.envelope_digest, verified.key_id) == (STATEMENT, sha256(data), key.key_id)
    assert key.sign(STATEMENT) == data


def test_all_statements_of_a_publication_can_be_signed_and_verified(key: KeyFile, trusted: TrustedKeys) -> None:
    for data in Signing(key).sign(APP).values():
        assert trusted.verify(data).statement["subject"][0]["name"] == "app"


def test_keys_of_openssl_are_read_and_named_by_their_public_half(tmp_path: Path) -> None:
    path, keys = tmp_path / "key.pem", tmp_path / "keys"
    keys.mkdir()
    subprocess.run(["openssl", "genpkey", "-algorithm", "ed25519", "-out", path], check=True, timeout=60)
    command = ["openssl", "pkey", "-in", path, "-pubout", "-out", keys / "public.pem"]
    subprocess.run(command, check=True, timeout=60)
    der = subprocess.run(
        ["openssl", "pkey", "-in", path, "-pubout", "-outform", "DER"], check=True, timeout=60, capture_output=True
    ).stdout
    key = KeyFile(path)
    assert key.key_id == sha256(der).removeprefix("sha256:")[:16]
    assert key.public_key == (keys / "public.pem").read_text()
    assert TrustedKeys(keys).trusted() == {key.key_id}


def certificate(path: Path) -> bytes:
    """A self-signed certificate of the key in `path`, long expired, as PEM."""
    private = load_pem_private_key(path.read_bytes(), None)
    assert isinstance(private, Ed25519PrivateKey)
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "gate")])
    begin = datetime.datetime(2020, 1, 1, tzinfo=datetime.UTC)
    builder = x509.CertificateBuilder(name, name, private.public_key(), 1, begin, begin + datetime.timedelta(days=1))
    return builder.sign(private, None).public_bytes(Encoding.PEM)


def test_a_certificate_gives_its_public_key(tmp_path: Path, key: KeyFile) -> None:
    (tmp_path / "keys").mkdir()
    (tmp_path / "keys" / "tls.pem").write_bytes(certificate(tmp_path / "gate" / "key.pem"))
    trusted = TrustedKeys(tmp_path / "keys")
    assert trusted.verify(key.sign(STATEMENT)).key_id == key.key_id


def test_another_key_is_refused_and_both_are_named(tmp_path: Path, key: KeyFile, trusted: TrustedKeys) -> None:
    other = signing_key(tmp_path / "other")
    text = refusal(trusted, other.sign(STATEMENT))
    assert text == f"it is signed with key '{other.key_id}', which is not trusted here (trusted: {key.key_id})"
    assert refusal(trusting(tmp_path / "none"), key.sign(STATEMENT)).endswith("(trusted: none)")


def test_another_key_under_the_name_of_a_trusted_one_does_not_fit(
    tmp_path: Path, key: KeyFile, trusted: TrustedKeys
) -> None:
    forged = edited(
        signing_key(tmp_path / "other").sign(STATEMENT), lambda d: d["signatures"][0].update(keyid=key.key_id)
    )
    assert "does not fit: it was changed after signing" in refusal(trusted, forged)


def test_an_envelope_edited_after_signing_is_refused(key: KeyFile, trusted: TrustedKeys) -> None:
    swapped = canonical_json(suite_statement(artefact(content="other"), POLICY.digest, result(POLICY.suites[0])))
    data = edited(key.sign(STATEMENT), lambda d: d.update(payload=base64.b64encode(swapped).decode()))
    assert refusal(trusted, data) == f"its signature by key {key.key_id} does not fit: it was changed after signing"


def test_every_form_has_one_sequence_of_bytes(key: KeyFile, trusted: TrustedKeys) -> None:
    data = key.sign(STATEMENT)
    for other in (data + b"\n", json.dumps(json.loads(data), indent=1).encode(), data.replace(b":", b": ", 1)):
        assert "is not canonical JSON" in refusal(trusted, other)
    assert "canonical JSON" in refusal(trusted, data.replace(b'{"payload"', b'{"payload":"","payload"', 1))
    padded = edited(data, lambda d: d["signatures"][0].update(sig=d["signatures"][0]["sig"][:-3] + "B=="))
    assert "base64" in refusal(trusted, padded)
    spaced = json.dumps(STATEMENT).encode()
    assert "its statement is not canonical JSON" in refusal(trusted, signed_anyway(key, spaced))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda d: d.pop("signatures"), "no DSSE envelope"),
        (lambda d: d.update(more=1), "no DSSE envelope"),
        (lambda d: d.update(payloadType="text/plain"), "its payloadType is 'text/plain'"),
        (lambda d: d.update(payloadType=[]), "its payloadType is '[]'"),
        (lambda d: d.update(signatures=[]), "exactly one signature"),
        (lambda d: d.update(signatures=d["signatures"] * 2), "exactly one signature"),
        (lambda d: d.update(signatures={}), "exactly one signature"),
        (lambda d: d.update(signatures=["text"]), "must have keyid and sig"),
        (lambda d: d["signatures"][0].update(cert=""), "must have keyid and sig"),
        (lambda d: d["signatures"][0].update(keyid=[]), "must be text"),
        (lambda d: d.update(payload=None), "must be text"),
        (lambda d: d.update(payload="%%%"), "its payload is not base64"),
        (lambda d: d.update(payload="ä"), "its payload is not base64"),
        (lambda d: d["signatures"][0].update(sig=""), "its signature has 0 bytes, not 64"),
        (lambda d: d["signatures"][0].update(keyid="x" * 9999), "which is not trusted here"),
    ],
)
def test_another_form_is_refused(
    key: KeyFile, trusted: TrustedKeys, change: Callable[[dict[str, Any]], None], expected: str
) -> None:
    text = refusal(trusted, edited(key.sign(STATEMENT), change))
    assert expected in text
    assert len(text) < 500


NO_ENVELOPES = {
    "empty": (b"", "it is not readable as JSON"),
    "other encoding": (b"\xff\xfe{}", "it is not UTF-8"),
    "list": (b"[]", "it must be a JSON object"),
    "null": (b"null", "it must be a JSON object"),
    "no number": (b'{"payload":NaN}', "it is not readable as JSON"),
    "endless number": (b'{"payload":' + b"9" * 5000 + b"}", "it is not readable as JSON"),
    "deep list": (b"[" * 100_000, "it is not readable as JSON: nested deeper than 100 levels"),
    "deep mapping": (b'{"a":' * 20_000, "it is not readable as JSON: nested deeper than 100 levels"),
    "huge": (b"x" * (ENVELOPE_BYTES_MAX + 1), f"it is no envelope: {ENVELOPE_BYTES_MAX + 1} bytes"),
}


@pytest.mark.parametrize(("data", "expected"), NO_ENVELOPES.values(), ids=list(NO_ENVELOPES))
def test_what_is_no_envelope_is_refused(trusted: TrustedKeys, data: bytes, expected: str) -> None:
    assert expected in refusal(trusted, data)


def deep(levels: int) -> Any:
    value: Any = 1
    for _ in range(levels):
        value = [value]
    return value


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"_type": "https://in-toto.io/Statement/v0.1"}, "known are https://in-toto.io/Statement/v1 with"),
        ({"predicateType": "https://slsa.dev/provenance/v1"}, "'https://slsa.dev/provenance/v1'; known are"),
        ({"predicateType": []}, "known are"),
        ({"subject": []}, "not in the form of in-toto: At least one subject required"),
        ({"subject": [{"name": "app"}]}, "At least one digest required"),
        ({"subject": "app"}, "not in the form of in-toto"),
        ({"subject": None}, "At least one subject required"),
        ({"predicate": {}}, "Predicate object required"),
        ({"predicate": None}, "not in the form of in-toto"),
        ({"predicate": ["PASSED"]}, "not in the form of in-toto"),
        ({"predicate": {"result": "PASSED", "score": 1}}, "not in the form of in-toto"),
        ({"predicate": {"result": ["PASSED"]}}, "not in the form of in-toto"),
        ({"predicate": {"result": deep(50)}}, "not in the form of in-toto"),
        ({"predicate": {"result": "PASSED", "verifiedLevels": "ALL"}}, "verifiedLevels must be a list of texts"),
        ({"more": 1}, "not in the form of in-toto"),
    ],
)
def test_a_statement_of_another_form_is_neither_signed_nor_believed(
    key: KeyFile, trusted: TrustedKeys, change: dict[str, Any], expected: str
) -> None:
    statement = STATEMENT | change
    assert expected in refusal(trusted, signed_anyway(key, canonical_json(statement)))
    with pytest.raises(InputError, match="its statement"):
        key.sign(statement)


def test_a_statement_that_is_too_long_is_not_signed(key: KeyFile) -> None:
    predicate = STATEMENT["predicate"] | {"passedTests": ["x" * 1000] * 300}
    with pytest.raises(InputError, match=f"too long to be signed: \\d+ of {ENVELOPE_BYTES_MAX} bytes"):
        key.sign(STATEMENT | {"predicate": predicate})


def test_a_folder_is_read_again_when_its_keys_changed(tmp_path: Path, key: KeyFile, trusted: TrustedKeys) -> None:
    second = signing_key(tmp_path / "second")
    trusting(tmp_path / "keys", key, second)
    assert trusted.trusted() == {key.key_id, second.key_id}
    assert trusted.verify(key.sign(STATEMENT)).key_id == key.key_id
    assert trusted.verify(second.sign(STATEMENT)).key_id == second.key_id
    trusting(tmp_path / "keys", second)
    assert trusted.trusted() == {second.key_id}
    assert f"key '{key.key_id}', which is not trusted here" in refusal(trusted, key.sign(STATEMENT))


def test_every_file_that_is_no_key_is_named(tmp_path: Path, key: KeyFile) -> None:
    keys = tmp_path / "keys"
    trusting(keys, key)
    elliptic = generate_private_key(SECP256R1()).public_key()
    (keys / "curve.pem").write_bytes(elliptic.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    (keys / "text.pem").write_text("no key")
    (keys / "private.pem").write_bytes((tmp_path / "gate" / "key.pem").read_bytes())
    (keys / "broken.pem").write_text("-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n")
    (keys / "README").write_text("other files do not matter")
    with pytest.raises(InputError) as caught:
        TrustedKeys(keys)
    named = [part.partition(": ")[0] for part in str(caught.value).split("; ")]
    assert named == [f"trusted key {keys / name}.pem" for name in ("broken", "curve", "private", "text")]
    assert "PRIVATE" not in str(caught.value)


def test_a_folder_that_is_missing_or_too_full_is_refused(tmp_path: Path, key: KeyFile) -> None:
    with pytest.raises(InputError, match=r"trusted keys .*No such file or directory; mount the public keys there"):
        TrustedKeys(tmp_path / "nothing")
    trusting(tmp_path / "keys", key)
    for number in range(KEYS_MAX):
        (tmp_path / "keys" / f"{number}.pem").write_text(key.public_key)
    with pytest.raises(InputError, match=f"{KEYS_MAX + 1} files; at most {KEYS_MAX}"):
        TrustedKeys(tmp_path / "keys")


def test_a_signing_key_of_another_kind_is_refused_without_showing_it(tmp_path: Path) -> None:
    path = tmp_path / "key.pem"
    with pytest.raises(InputError, match=r"signing key .*No such file or directory; mount the Secret"):
        KeyFile(path)
    path.write_text("secret words")
    with pytest.raises(InputError, match="no PEM private key") as caught:
        KeyFile(path)
    assert "secret words" not in str(caught.value)
    elliptic = generate_private_key(SECP256R1())
    path.write_bytes(elliptic.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    with pytest.raises(InputError, match="must be an ed25519 key"):
        KeyFile(path)


@pytest.mark.processes
def test_the_reference_shows_how_to_verify_by_hand(tmp_path: Path, key: KeyFile) -> None:
    page = DOCS / "reference" / "evidence.md"
    commands = page.read_text(encoding="utf-8").partition("```sh\n")[2].partition("```")[0]
    data = Signing(key).sign(APP)["summary"]
    (tmp_path / "envelope.json").write_bytes(data)
    (tmp_path / "key.pem").write_text(key.public_key)

    def run() -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            ["sh", "-c", commands], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
        )

    good = run()
    assert "Signature Verified Successfully" in good.stdout
    assert sha256(data).removeprefix("sha256:") in good.stdout
    (tmp_path / "key.pem").write_text(signing_key(tmp_path / "other").public_key)
    assert "Signature Verification Failure" in run().stdout
