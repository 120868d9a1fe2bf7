"""Stores of the authority, of servers' certificates and of whom to trust, and who makes certificates.

UnavailableError when the API server does not answer or the fault passes, InputError when it refuses.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Protocol

from robotkube.delivery.certificates.core.issuance import AccountCertificate
from robotkube.delivery.certificates.core.register import Register
from robotkube.foundation.certificates.core.lives import Life, Pair


class CertificateObjects(Protocol):
    """The objects of the platform that hold certificates. They are there before the process is: it fills them."""

    def authority(self) -> Pair | None:
        """The authority; None while its Secret is empty. InputError when only a part of it is there."""
        ...

    def keep_authority(self, authority: Pair) -> None:
        """Put the authority into its empty Secret. UnavailableError when the Secret has changed since it was read."""
        ...

    def certificate(self, secret: str) -> Pair | None:
        """The certificate in this Secret; None while it is empty, or holds only a part of one."""
        ...

    def put_certificate(self, secret: str, certificate: Pair) -> None:
        """Replace the certificate and the key in this Secret, both at once."""
        ...

    def of_account(self, account: AccountCertificate) -> Pair | None:
        """The certificate of an account, as above."""
        ...

    def put_of_account(self, account: AccountCertificate, certificate: Pair) -> None:
        """Replace it, both at once."""
        ...

    def register(self) -> tuple[Register, str]:
        """What was issued to accounts, and the list of revoked ones, as PEM; empty while there is none."""
        ...

    def put_register(self, register: Register, revocations: str) -> None:
        """Replace both at once. UnavailableError when they have changed since they were read."""
        ...

    def addresses(self, service: str) -> Sequence[str]:
        """The addresses of a Service of the platform; none while it has none."""
        ...

    def trusted(self, namespace: str) -> str:
        """The certificate of the authority as PEM, as this namespace has it; empty when it has none."""
        ...

    def publish(self, namespace: str, certificate: str) -> None:
        """Tell a namespace whom to trust."""
        ...


class ShutAccounts(Protocol):
    """Whoever knows which accounts main shuts out."""

    def shut(self, authority: str) -> frozenset[str]:
        """Their names now, by a server that has a certificate of the authority (PEM) where it has any. UnavailableError
        while nobody says it."""
        ...


class Issuer(Protocol):
    """Who makes certificates and reads them. InputError when one cannot be read."""

    def new_authority(self, name: str, now: float) -> Pair:
        """Another authority each time."""
        ...

    def is_authority(self, pair: Pair) -> bool:
        """Return whether it may sign others."""
        ...

    def issue(self, authority: Pair, names: Collection[str], now: float, seconds: float) -> Pair:
        """A certificate of the authority, for `seconds` from `now` on."""
        ...

    def issue_account(self, authority: Pair, account: str, now: float, seconds: float) -> Pair:
        """A certificate that proves an account, as above."""
        ...

    def revocation_list(self, authority: Pair, revoked: Mapping[int, float], now: float) -> str:
        """The authority's list of revoked numbers, as PEM."""
        ...

    def listed(self, text: str, authority: Pair) -> frozenset[int] | None:
        """The numbers in such a list; None when it is none of this authority's."""
        ...

    def describe(self, pair: Pair, authority: Pair) -> Life:
        """What a certificate says, seen from this authority."""
        ...
