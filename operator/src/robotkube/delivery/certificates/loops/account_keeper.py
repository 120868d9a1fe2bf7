"""Keeping the certificates by which accounts at the broker are proved, and the list of those that are revoked."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from robotkube.delivery.certificates.core.issuance import AccountCertificate, AccountIssuance
from robotkube.delivery.certificates.core.register import IssuedCertificate, Register
from robotkube.delivery.certificates.ports import CertificateObjects, Issuer, ShutAccounts
from robotkube.errors import InputError, RobotKubeError, UnavailableError
from robotkube.foundation.certificates.core.lives import Life, Pair, reason_to_replace

log = logging.getLogger(__name__)

T = TypeVar("T")


def _nothing() -> None:
    """Do nothing meanwhile."""


def _with(meanwhile: Callable[[], None], items: Iterable[T]) -> Iterator[T]:
    """The items, with a call before each."""
    for item in items:
        meanwhile()
        yield item


def _life_of(account: AccountCertificate, life: Life | None) -> Mapping[str, Any]:
    times = {} if life is None else {"begin": life.begin, "end": life.end, "renewal": life.renewal}
    return {"account": account.account, "namespace": account.namespace, "life": times or None}


@dataclass(frozen=True)
class _Due:
    """A certificate that was made and stands in no Secret yet."""

    account: AccountCertificate
    pair: Pair
    cause: str


class AccountKeeper:
    """The certificates of a platform's accounts, on the keeper's thread. `wall` in seconds since 1970."""

    def __init__(
        self,
        objects: CertificateObjects,
        issuer: Issuer,
        issuance: AccountIssuance,
        shut: ShutAccounts,
        wall: Callable[[], float],
    ) -> None:
        self._objects = objects
        self._issuer = issuer
        self._issuance = issuance
        self._shut = shut
        self._wall = wall
        self._known: frozenset[str] | None = None  # whom main shut out at the last look
        self._authority = ""
        self._made: dict[str, Pair] = {}  # by account: what could not be put into its Secret yet
        self.problem = ""
        self.lives: dict[str, Life] = {}  # by account, of those whose certificate is not revoked
        self.looked = False  # at all that can be read, once at least
        self.issued = self.revoked = 0

    def has_news(self) -> bool:
        """Return whether main shuts out others than at the last look, as far as somebody says it."""
        try:
            return bool(self._authority) and self._shut.shut(self._authority) != self._known
        except UnavailableError:
            return False

    def standing(self) -> Iterator[tuple[AccountCertificate, Life]]:
        """The certificates that are there and not revoked, each with its life."""
        for account in self._issuance.certificates:
            if account.account in self.lives:
                yield account, self.lives[account.account]

    def as_json(self) -> Sequence[Mapping[str, Any]] | None:
        """Every account with the life of its certificate, null where it has none that holds; None before the first
        look. Times in seconds since 1970; any thread may ask."""
        if not self.looked:
            return None
        lives = dict(self.lives)
        return [_life_of(account, lives.get(account.account)) for account in self._issuance.certificates]

    def keep(self, authority: Pair, meanwhile: Callable[[], None] = _nothing) -> None:
        """Issue what is due, and revoke what main shuts out. Who may not be at the broker gets nothing; while nobody
        says who that is, everybody keeps and gets his, but accounts that are reserved or revoked; `problem` says so.
        What fails for one account keeps no other from its own: it is raised at the end. `meanwhile` is called between
        two accounts: a fleet's certificates take seconds."""
        self._authority = authority.certificate
        failures: list[RobotKubeError] = []
        shut = self._asked()
        register, revocations = self._objects.register()
        present = self._read(failures, meanwhile)
        self.lives = self._described(present, authority)
        self.looked = True
        adopted = self._adopted(register.kept(self._wall()))
        revoking = adopted.revoking(shut or (), self._issuance.certificates, self._wall())
        after, due = self._issue(revoking, _with(meanwhile, present), shut, authority)
        if after != register or self._issuer.listed(revocations, authority) != frozenset(after.revoked):
            # before any of it is shown: what is not in the register cannot be revoked
            text = self._issuer.revocation_list(authority, after.revoked, self._wall())
            self._objects.put_register(after, text)
            self._tell_revoked(register, after)
        for one in _with(meanwhile, due):
            self._put(one, authority, failures)
        revoked = after.revoked
        self.lives = {name: life for name, life in self.lives.items() if life.serial not in revoked}
        self._known = shut
        if failures:
            raise failures[0]

    def _read(
        self, failures: list[RobotKubeError], meanwhile: Callable[[], None]
    ) -> dict[AccountCertificate, Pair | None]:
        """The certificates of the accounts whose Secret can be read."""
        present = {}
        for account in _with(meanwhile, self._issuance.certificates):
            try:
                present[account] = self._objects.of_account(account)
            except RobotKubeError as error:
                failures.append(error)
        return present

    def _put(self, due: _Due, authority: Pair, failures: list[RobotKubeError]) -> None:
        """Put a certificate where its account is; one that cannot be is put there at the next look, and is not made
        anew each time."""
        name = due.account.account
        try:
            self._objects.put_of_account(due.account, due.pair)
        except RobotKubeError as error:
            self._made[name] = due.pair
            failures.append(error)
            return
        self._made.pop(name, None)
        self.lives[name] = life = self._issuer.describe(due.pair, authority)
        self.issued += 1
        log.info("certificate issued account=%s cause=%s end=%.0f", name, due.cause.replace(" ", "-"), life.end)

    def _asked(self) -> frozenset[str] | None:
        """Whom main shuts out; None while nobody says it, which is logged once."""
        before, self.problem = self.problem, ""
        try:
            return self._shut.shut(self._authority)
        except UnavailableError as error:
            self.problem = f"nobody says which accounts main shuts out: {error}"
        if self.problem != before:
            log.warning("certificates: %s", self.problem)
        return None

    def _described(self, present: Mapping[AccountCertificate, Pair | None], authority: Pair) -> dict[str, Life]:
        """The lives of what is there by account; what cannot be read is replaced as if there were none."""
        lives = {}
        for account, pair in present.items():
            try:
                if pair is not None:
                    lives[account.account] = self._issuer.describe(pair, authority)
            except InputError as error:
                log.warning("Secret %s/%s: %s", account.namespace, account.secret, error)
        return lives

    def _adopted(self, register: Register) -> Register:
        """A register with what the authority signed and the register does not have, as after its loss."""
        for account in self._issuance.certificates:
            life = self.lives.get(account.account)
            if life is not None and life.signed and register.entry(life.serial) is None:
                register = register.added(IssuedCertificate(account.account, life.serial, life.end, account.number))
        return register

    def _issue(
        self,
        register: Register,
        accounts: Iterable[AccountCertificate],
        shut: frozenset[str] | None,
        authority: Pair,
    ) -> tuple[Register, list[_Due]]:
        """Make what is due, and enter it."""
        due = []
        for account in accounts:
            reason = self._reason(account, register, shut)
            if not reason:
                continue
            pair = self._made_before(account, register, authority)
            if pair is None:
                pair = self._issuer.issue_account(authority, account.account, self._wall(), self._issuance.seconds)
                life = self._issuer.describe(pair, authority)
                register = register.added(IssuedCertificate(account.account, life.serial, life.end, account.number))
            due.append(_Due(account, pair, reason))
        return register, due

    def _made_before(self, account: AccountCertificate, register: Register, authority: Pair) -> Pair | None:
        """A certificate that was made and entered at an earlier look, and still holds."""
        pair = self._made.get(account.account)
        if pair is None:
            return None
        life = self._issuer.describe(pair, authority)
        entry = register.entry(life.serial)
        holds = entry is not None and not entry.revoked and not reason_to_replace(life, [account.account], self._wall())
        return pair if holds else None

    def _reason(self, account: AccountCertificate, register: Register, shut: frozenset[str] | None) -> str:
        """The reason why an account gets a certificate now; empty when it does not."""
        life = self.lives.get(account.account)
        entry = register.entry(life.serial) if life is not None else None
        revoked = entry is not None and bool(entry.revoked)
        if shut is None:
            other_number = entry is not None and entry.number != account.number
            if (revoked and not other_number) or (account.reserved and life is None):
                return ""
        elif account.account in shut:
            return ""
        return reason_to_replace(life, [account.account], self._wall()) or ("it is revoked" if revoked else "")

    def _tell_revoked(self, before: Register, after: Register) -> None:
        for one in after.issued:
            if one.revoked and one.serial not in before.revoked:
                self.revoked += 1
                log.warning("certificate revoked account=%s serial=%x", one.account, one.serial)
