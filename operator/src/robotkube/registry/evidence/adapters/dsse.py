"""Signed evidence: in-toto statements (in-toto-attestation), DSSE envelopes (securesystemslib), keys (cryptography).

An envelope is canonical JSON with one ed25519 signature, so there is one sequence of bytes, and one digest, for what
was signed. Everything about an envelope is checked before its content is believed: size, form, key, signature, then the
statement against in-toto's own forms. Keys are the PEM files that openssl and Helm's genPrivateKey "ed25519" write.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    PublicFormat,
    load_pem_private_key,
    load_pem_public_key,
)
from google.protobuf import json_format
from in_toto_attestation.predicates.test_result.v0.test_result_pb2 import TestResult
from in_toto_attestation.predicates.vsa.v1.vsa_pb2 import VerificationSummary
from in_toto_attestation.v1.statement import Statement
from in_toto_attestation.v1.statement_pb2 import Statement as StatementMessage
from securesystemslib.dsse import Envelope
from securesystemslib.exceptions import VerificationError
from securesystemslib.signer import CryptoSigner, Key, Signature, SSlibKey

from robotkube.errors import InputError
from robotkube.foundation.documents.core.digests import canonical_json, sha256
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.registry.evidence.core.statements import (
    ENVELOPE_MEDIA_TYPE,
    STATEMENT_TYPE,
    SUITE_PREDICATE,
    SUMMARY_PREDICATE,
    VerifiedStatement,
)

ENVELOPE_BYTES_MAX = 256 * 1024
KEY_BYTES_MAX = 16 * 1024
KEYS_MAX = 16
KEY_ID_CHARACTERS = 16
SIGNATURE_BYTES = 64  # of ed25519
DEPTH_MAX = 32
PREDICATES = {SUITE_PREDICATE: TestResult, SUMMARY_PREDICATE: VerificationSummary}


class KeyFile:
    """Port Signer: the private key in a PEM file (PKCS #8, ed25519, without a password)."""

    def __init__(self, path: Path) -> None:
        """InputError names the file when it holds no such key; its content is never shown."""
        self._key = read_private_key(path)
        self._public = self._key.public_key()
        self.key_id = key_id(self._public)
        self.public_key = self._public.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo).decode()
        self._signer = CryptoSigner(self._key, SSlibKey.from_crypto(self._public, self.key_id))

    def sign(self, statement: Mapping[str, Any]) -> bytes:
        """The statement in a signed envelope; InputError when it is not one that can be verified again."""
        _check_statement(statement)
        envelope = Envelope(canonical_json(statement), ENVELOPE_MEDIA_TYPE, {})
        envelope.sign(self._signer)
        data = canonical_json(envelope.to_dict())
        if len(data) > ENVELOPE_BYTES_MAX:
            raise InputError(f"the statement is too long to be signed: {len(data)} of {ENVELOPE_BYTES_MAX} bytes")
        return data


class TrustedKeys:
    """Port Verifier: the public keys (PEM: keys or certificates) in the files `*.pem` of a folder. A changed folder is
    seen by `trusted`; until then the keys stay as they were."""

    def __init__(self, folder: Path) -> None:
        """InputError names every file that holds no ed25519 key."""
        self._folder = folder
        self._texts: dict[str, bytes] = {}
        self._keys: dict[str, Key] = {}
        self.trusted()

    def trusted(self) -> frozenset[str]:
        """Ids of the keys in the folder."""
        texts = _key_texts(self._folder)
        if texts != self._texts:
            self._keys = _read_keys(self._folder, texts)
            self._texts = texts
        return frozenset(self._keys)

    def verify(self, envelope: bytes) -> VerifiedStatement:
        """The statement in the envelope; InputError says why it is not believed."""
        document = _read_envelope(envelope)
        name = document["signatures"][0]["keyid"]
        key = self._keys.get(name)
        if key is None:
            known = ", ".join(sorted(self._keys)) or "none"
            raise InputError(f"it is signed with key {name[:64]!r}, which is not trusted here (trusted: {known})")
        payload = _verified_payload(document, key)
        statement = _read_json(payload, "its statement")
        _check_statement(statement)
        return VerifiedStatement(statement, sha256(envelope), name)


def key_id(key: Ed25519PublicKey) -> str:
    """The first 16 hex of the SHA-256 over the key as DER SubjectPublicKeyInfo."""
    return hashlib.sha256(key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)).hexdigest()[
        :KEY_ID_CHARACTERS
    ]


def read_private_key(path: Path) -> Ed25519PrivateKey:
    """The key in a PEM file; InputError names the file when it holds none, and never shows its content."""
    try:
        key = load_pem_private_key(path.read_bytes()[:KEY_BYTES_MAX], None)
    except OSError as error:
        raise InputError(f"signing key {path}: {error.strerror}; mount the Secret with the key") from error
    except (ValueError, TypeError, UnsupportedAlgorithm):
        raise InputError(f"signing key {path}: no PEM private key (PKCS #8, no password)") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise InputError(f"signing key {path}: must be an ed25519 key: openssl genpkey -algorithm ed25519")
    return key


def _key_texts(folder: Path) -> dict[str, bytes]:
    """File name -> content of the folder's `*.pem`, links followed (a ConfigMap is mounted as links)."""
    try:
        paths = sorted(path for path in folder.iterdir() if path.suffix == ".pem")
        if len(paths) > KEYS_MAX:
            raise InputError(f"trusted keys {folder}: {len(paths)} files; at most {KEYS_MAX}, remove old ones")
        return {path.name: path.read_bytes()[: KEY_BYTES_MAX + 1] for path in paths}
    except OSError as error:
        raise InputError(f"trusted keys {folder}: {error.strerror}; mount the public keys there") from error


def _read_keys(folder: Path, texts: Mapping[str, bytes]) -> dict[str, Key]:
    keys: dict[str, Key] = {}
    problems = []
    for name, text in texts.items():
        public = _public_key(text)
        if public is None:
            problems.append(f"trusted key {folder / name}: no PEM public key or certificate of an ed25519 key")
        else:
            keys[key_id(public)] = SSlibKey.from_crypto(public, key_id(public))
    if problems:
        raise InputError("; ".join(problems))
    return keys


def _public_key(text: bytes) -> Ed25519PublicKey | None:
    """The key of a PEM public key or certificate; None when it is neither. A certificate's dates and issuer mean
    nothing here: what is trusted is what stands in the folder."""
    try:
        if b"-----BEGIN CERTIFICATE-----" in text:
            key: object = x509.load_pem_x509_certificate(text).public_key()
        else:
            key = load_pem_public_key(text)
    except (ValueError, UnsupportedAlgorithm):
        return None
    return key if isinstance(key, Ed25519PublicKey) else None


def _read_envelope(data: bytes) -> dict[str, Any]:
    """The envelope as a document of exactly the known form."""
    if len(data) > ENVELOPE_BYTES_MAX:
        raise InputError(f"it is no envelope: {len(data)} bytes, at most {ENVELOPE_BYTES_MAX}")
    document = _read_json(data, "it")
    if set(document) != {"payload", "payloadType", "signatures"}:
        raise InputError("it is no DSSE envelope: payload, payloadType and signatures are needed, nothing else")
    if document["payloadType"] != ENVELOPE_MEDIA_TYPE:
        raise InputError(f"its payloadType is {str(document['payloadType'])[:64]!r}, not {ENVELOPE_MEDIA_TYPE!r}")
    signatures = document["signatures"]
    if not isinstance(signatures, list) or len(signatures) != 1:
        raise InputError("it must have exactly one signature")
    if not isinstance(signatures[0], dict) or set(signatures[0]) != {"keyid", "sig"}:
        raise InputError("its signature must have keyid and sig, nothing else")
    if not all(isinstance(text, str) for text in (document["payload"], *signatures[0].values())):
        raise InputError("its payload, keyid and sig must be text")
    return document


def _verified_payload(document: Mapping[str, Any], key: Key) -> bytes:
    signature = document["signatures"][0]
    payload = _decode(document["payload"], "payload")
    signed = _decode(signature["sig"], "signature")
    if len(signed) != SIGNATURE_BYTES:
        raise InputError(f"its signature has {len(signed)} bytes, not {SIGNATURE_BYTES}: no ed25519 signature")
    name = signature["keyid"]
    envelope = Envelope(payload, document["payloadType"], {name: Signature(name, signed.hex())})
    try:
        envelope.verify([key], 1)
    except VerificationError:
        raise InputError(f"its signature by key {name} does not fit: it was changed after signing") from None
    return payload


def _decode(text: str, what: str) -> bytes:
    try:
        data = base64.b64decode(text.encode("ascii"), validate=True)
    except (UnicodeEncodeError, binascii.Error):
        raise InputError(f"its {what} is not base64") from None
    if base64.b64encode(data).decode() != text:
        raise InputError(f"its {what} is not in the one form of base64 that is used here")
    return data


def _read_json(data: bytes, what: str) -> dict[str, Any]:
    """The mapping that `data` is the canonical JSON of."""
    try:
        document = read_json(data.decode("utf-8"), constant=_no_constant)
        canonical = canonical_json(document)
    except UnicodeDecodeError:
        raise InputError(f"{what} is not UTF-8") from None
    except ValueError as error:
        raise InputError(f"{what} is not readable as JSON: {error}") from None
    if not isinstance(document, dict):
        raise InputError(f"{what} must be a JSON object")
    if canonical != data:
        raise InputError(f"{what} is not canonical JSON (keys sorted, no spaces): it was written or changed by others")
    return document


def _no_constant(name: str) -> NoReturn:
    raise ValueError(name)


def _check_statement(statement: Mapping[str, Any]) -> None:
    """InputError unless it is an in-toto Statement v1 with one of our predicates, each in its own form."""
    kind = statement.get("predicateType")
    form = PREDICATES.get(kind) if isinstance(kind, str) else None
    if statement.get("_type") != STATEMENT_TYPE or form is None:
        description = f"{str(statement.get('_type'))[:64]!r} with predicate {str(kind)[:64]!r}"
        raise InputError(f"its statement is {description}; known are {STATEMENT_TYPE} with {', '.join(PREDICATES)}")
    try:
        message = json_format.ParseDict(dict(statement), StatementMessage(), max_recursion_depth=DEPTH_MAX)
        Statement.copy_from_pb(message).validate()
        predicate = _without_levels(statement["predicate"])
        json_format.ParseDict(predicate, form(), max_recursion_depth=DEPTH_MAX)
    except (json_format.ParseError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"its statement is not in the form of in-toto: {' '.join(str(error).split())[:200]}") from None


def _without_levels(predicate: Mapping[str, Any]) -> dict[str, Any]:
    """The predicate without `verifiedLevels`, checked here: a list of texts by SLSA's text, one text by the library."""
    levels = predicate.get("verifiedLevels", [])
    if not isinstance(levels, list) or not all(isinstance(level, str) for level in levels):
        raise ValueError("verifiedLevels must be a list of texts")
    return {name: value for name, value in predicate.items() if name != "verifiedLevels"}
