"""Certificates that are made here (cryptography): an authority once, what it signs for servers and for accounts, and
its list of those that are revoked. Keys are ECDSA on P-256, which every client of TLS 1.2 knows and whose handshakes
are cheap."""

from __future__ import annotations

import ipaddress
import time
from collections.abc import Collection, Iterable, Mapping
from datetime import UTC, datetime

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from robotkube.errors import InputError
from robotkube.foundation.certificates.core.lives import Issued, Life, Pair, begin_before

AUTHORITY_SECONDS = 10 * 365 * 86_400.0
THROW_AWAY_SECONDS = 2 * 86_400.0
COMMON_NAME_MAX = 64  # characters, by X.520
LIST_EARLY_SECONDS = 86_400.0
"""A list that is not valid yet by a server's clock has everybody refused, and so has one that is too old: this one is
replaced when somebody is revoked, and lives as long as its authority."""


def new_authority(name: str, now: float, seconds: float = AUTHORITY_SECONDS) -> Pair:
    """Another authority each time; it signs certificates of servers and clients, and no further authority."""
    key = ec.generate_private_key(ec.SECP256R1())
    subject = _subject(name)
    builder = _builder(subject, subject, key, key, begin_before(now, seconds), now + seconds)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    builder = builder.add_extension(_usage(key_cert_sign=True, crl_sign=True), critical=True)
    return _pair(builder.sign(key, SHA256()), key)


def issue(authority: Pair, names: Collection[str], now: float, seconds: float) -> Pair:
    """A server's certificate for `names` (DNS names and addresses; the first is its common name), with a key of its
    own, for `seconds` from now on; never longer than its authority."""
    return _leaf(authority, names, now, seconds, ExtendedKeyUsageOID.SERVER_AUTH)


def issue_account(authority: Pair, account: str, now: float, seconds: float) -> Pair:
    """A client's certificate whose common name is the account, as above. No server can show it, and an account cannot
    be proved by a server's."""
    return _leaf(authority, [account], now, seconds, ExtendedKeyUsageOID.CLIENT_AUTH)


def _leaf(authority: Pair, names: Collection[str], now: float, seconds: float, usage: x509.ObjectIdentifier) -> Pair:
    issuer, issuer_key = _read(authority)
    key = ec.generate_private_key(ec.SECP256R1())
    end = min(now + seconds, issuer.not_valid_after_utc.timestamp())
    subject = _subject(next(iter(names)))
    builder = _builder(subject, issuer.subject, key, issuer_key, begin_before(now, seconds), end)
    builder = builder.add_extension(x509.SubjectAlternativeName(list(_alternatives(names))), critical=False)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    builder = builder.add_extension(_usage(digital_signature=True), critical=True)
    builder = builder.add_extension(x509.ExtendedKeyUsage([usage]), critical=False)
    return _pair(builder.sign(issuer_key, SHA256()), key)


def throw_away(name: str, seconds: float = THROW_AWAY_SECONDS) -> Issued:
    """A certificate for `name`, of an authority that signs nothing else: its key is forgotten here."""
    now = time.time()
    authority = new_authority(f"{name}, for one run", now, seconds)
    return Issued(authority.certificate, issue(authority, [name], now, seconds))


def describe(pair: Pair, authority: Pair) -> Life:
    """What a certificate says, and whether key and authority are its own. InputError when it cannot be read."""
    certificate, key = _read(pair)
    issuer, _ = _read(authority)
    try:
        certificate.verify_directly_issued_by(issuer)
        signed = True
    except (ValueError, TypeError, InvalidSignature):
        signed = False
    return Life(
        names=frozenset(_names(certificate)),
        begin=certificate.not_valid_before_utc.timestamp(),
        end=certificate.not_valid_after_utc.timestamp(),
        has_key=certificate.public_key() == key.public_key(),
        signed=signed,
        serial=certificate.serial_number,
    )


def revocation_list(authority: Pair, revoked: Mapping[int, float], now: float) -> str:
    """The authority's list of what it has revoked, as PEM: the certificates' numbers, each with the moment."""
    issuer, key = _read(authority)
    builder = (
        x509.CertificateRevocationListBuilder()
        .issuer_name(issuer.subject)
        .last_update(datetime.fromtimestamp(now - LIST_EARLY_SECONDS, UTC))
        .next_update(issuer.not_valid_after_utc)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(key.public_key()), critical=False)
        .add_extension(x509.CRLNumber(int(now * 1000)), critical=False)
    )
    for serial, moment in sorted(revoked.items()):
        entry = x509.RevokedCertificateBuilder().serial_number(serial)
        builder = builder.add_revoked_certificate(entry.revocation_date(datetime.fromtimestamp(moment, UTC)).build())
    return builder.sign(key, SHA256()).public_bytes(Encoding.PEM).decode()


def listed(text: str, authority: Pair) -> frozenset[int] | None:
    """The numbers in a list of revoked certificates; None when it is none of this authority's."""
    issuer, _ = _read(authority)
    try:
        revocations = x509.load_pem_x509_crl(text.encode())
        if not revocations.is_signature_valid(issuer.public_key()):  # type: ignore[arg-type]
            return None
    except (ValueError, TypeError):
        return None
    return frozenset(entry.serial_number for entry in revocations)


def is_authority(pair: Pair) -> bool:
    """Return whether a certificate may sign others, and has its own key. InputError when it cannot be read."""
    certificate, key = _read(pair)
    try:
        signs = certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    except x509.ExtensionNotFound:
        signs = False
    return signs and certificate.public_key() == key.public_key()


def _read(pair: Pair) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    try:
        certificate = x509.load_pem_x509_certificate(pair.certificate.encode())
        key = load_pem_private_key(pair.key.encode(), None)
    except (ValueError, TypeError) as error:
        raise InputError(f"a certificate or its key cannot be read as PEM: {error}") from error
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise InputError(f"a certificate's key is {type(key).__name__}, must be one of an elliptic curve")
    return certificate, key


def _builder(
    subject: x509.Name,
    issuer: x509.Name,
    key: ec.EllipticCurvePrivateKey,
    issuer_key: ec.EllipticCurvePrivateKey,
    begin: float,
    end: float,
) -> x509.CertificateBuilder:
    identifier = x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer_key.public_key())
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(datetime.fromtimestamp(begin, UTC))
        .not_valid_after(datetime.fromtimestamp(end, UTC))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .add_extension(identifier, critical=False)
    )


def _subject(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name[:COMMON_NAME_MAX])])


def _usage(**given: bool) -> x509.KeyUsage:
    words = ("digital_signature", "content_commitment", "key_encipherment", "data_encipherment", "key_agreement")
    more = ("key_cert_sign", "crl_sign", "encipher_only", "decipher_only")
    return x509.KeyUsage(**{**dict.fromkeys((*words, *more), False), **given})


def _alternatives(names: Iterable[str]) -> Iterable[x509.GeneralName]:
    for name in names:
        try:
            yield x509.IPAddress(ipaddress.ip_address(name))
        except ValueError:
            yield x509.DNSName(name)


def _names(certificate: x509.Certificate) -> Iterable[str]:
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return []
    return [*names.get_values_for_type(x509.DNSName), *map(str, names.get_values_for_type(x509.IPAddress))]


def _pair(certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> Pair:
    return Pair(
        certificate.public_bytes(Encoding.PEM).decode(),
        key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()).decode(),
    )
