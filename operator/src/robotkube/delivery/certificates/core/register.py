"""The register of issued certificates: which account each number was issued to, until when it is valid, and since when
it is revoked. Kept until it has expired, so that what was issued can be revoked. Times in seconds since 1970."""

from __future__ import annotations

import json
from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from robotkube.delivery.certificates.core.issuance import AccountCertificate
from robotkube.errors import InputError

KEPT_SECONDS = 86_400.0
"""For as long after its end: clocks differ."""


@dataclass(frozen=True)
class IssuedCertificate:
    """One certificate of an account; `revoked` 0: it is not."""

    account: str
    serial: int
    end: float
    number: int = 0
    revoked: float = 0.0


@dataclass(frozen=True)
class Register:
    """What was issued, in its order."""

    issued: tuple[IssuedCertificate, ...] = ()

    def entry(self, serial: int) -> IssuedCertificate | None:
        """The certificate with this number, None when it was not issued here."""
        return next((one for one in self.issued if one.serial == serial), None)

    def added(self, certificate: IssuedCertificate) -> Register:
        """A register with one certificate more."""
        return replace(self, issued=(*self.issued, certificate))

    def kept(self, now: float) -> Register:
        """Without what has expired long enough ago."""
        return replace(self, issued=tuple(one for one in self.issued if one.end + KEPT_SECONDS > now))

    def revoking(self, shut: Container[str], accounts: Iterable[AccountCertificate], now: float) -> Register:
        """A register with all revoked that is of an account which is shut, is there no more, or has another number by
        now. What is revoked stays so."""
        numbers = {account.account: account.number for account in accounts}
        return replace(
            self,
            issued=tuple(
                replace(one, revoked=now)
                if not one.revoked and (one.account in shut or numbers.get(one.account) != one.number)
                else one
                for one in self.issued
            ),
        )

    def ends(self) -> Mapping[str, float]:
        """The moment at which an account's newest certificate that is not revoked expires, by account."""
        return {one.account: one.end for one in self.issued if not one.revoked}

    @property
    def revoked(self) -> Mapping[int, float]:
        """The numbers of revoked certificates, each with the moment."""
        return {one.serial: one.revoked for one in self.issued if one.revoked}


def written(register: Register) -> str:
    """The register as it is kept, JSON."""
    entries = [{**vars(one), "serial": f"{one.serial:x}"} for one in register.issued]
    return json.dumps({"issued": entries})


def read(text: str) -> Register:
    """The register as it was kept; an empty text is an empty one. InputError when it cannot be read."""
    try:
        return Register(tuple(_entry(one) for one in json.loads(text)["issued"])) if text else Register()
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"register.json cannot be read ({error!r}); bring it back, or empty the ConfigMap: then certificates that "
            "were replaced before cannot be revoked any more"
        ) from error


def _entry(entry: Mapping[str, Any]) -> IssuedCertificate:
    return IssuedCertificate(
        str(entry["account"]),
        int(entry["serial"], 16),
        float(entry["end"]),
        int(entry["number"]),
        float(entry["revoked"]),
    )
