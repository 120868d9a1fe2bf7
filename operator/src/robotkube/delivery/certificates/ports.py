"""Where the authority and servers' certificates stand, where others read whom to trust, and who makes certificates.

UnavailableError when the API server does not answer or the fault passes, InputError when it refuses.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Protocol

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

    def addresses(self, service: str) -> Sequence[str]:
        """The addresses of a Service of the platform; none while it has none."""
        ...

    def trusted(self, namespace: str) -> str:
        """The certificate of the authority as PEM, as this namespace has it; empty when it has none."""
        ...

    def publish(self, namespace: str, certificate: str) -> None:
        """Tell a namespace whom to trust."""
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

    def describe(self, pair: Pair, authority: Pair) -> Life:
        """What a certificate says, seen from this authority."""
        ...
