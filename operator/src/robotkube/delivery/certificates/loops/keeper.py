"""Keeping certificates: the authority is made once, each server's certificate renewed at two thirds of its life, and
every namespace of agents told whom to trust."""

from __future__ import annotations

import logging
import random
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robotkube.backoffs import Random, backoff
from robotkube.delivery.certificates.core.issuance import Issuance, ServerCertificate
from robotkube.delivery.certificates.loops.account_keeper import AccountKeeper
from robotkube.delivery.certificates.ports import CertificateObjects, Issuer
from robotkube.errors import InputError, RobotKubeError
from robotkube.foundation.certificates.core.lives import Life, Pair, reason_to_replace
from robotkube.foundation.runtime.ports import Series, by_one

CHECK_SECONDS = 60.0
SHUT_SECONDS = 5.0
"""Between two looks where accounts are proved by certificates, which end with main's word."""
CHECK_SHARE = 0.05
"""Of a certificate's life: one that lives for a minute is looked at every 3 s."""
RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX = 1.0, 4.0
AUTHORITY_NAME = "RobotKube platform"

log = logging.getLogger(__name__)


class CertificateKeeper:
    """The certificates of one platform, on one thread. `wall` in seconds since 1970."""

    def __init__(
        self,
        objects: CertificateObjects,
        issuer: Issuer,
        issuance: Issuance,
        wall: Callable[[], float],
        accounts: AccountKeeper | None = None,
        jitter: Random = random.random,
    ) -> None:
        self._accounts = accounts
        self._objects = objects
        self._issuer = issuer
        self._issuance = issuance
        self._wall = wall
        self._jitter = jitter
        self.problem = "nothing was looked at yet"
        self.lives: dict[str, Life] = {}
        self.issued = self.published = self.failed = 0
        lives = [certificate.seconds for certificate in issuance.certificates]
        lives += [] if issuance.accounts is None else [issuance.accounts.seconds]
        self._interval = min(CHECK_SECONDS, *(CHECK_SHARE * seconds for seconds in lives))
        self._servers_at = 0.0  # when servers' certificates were looked at last, by `wall`

    def run(self, stopping: threading.Event) -> None:
        """Keep them until `stopping` is set."""
        interval = self._interval
        failures = 0
        while not stopping.wait(0.0):
            self.step()
            failures = failures + 1 if self.problem else 0
            pause = (
                backoff(failures - 1, RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX, self._jitter) if failures else interval
            )
            self._rest(stopping, min(interval, pause))

    def _rest(self, stopping: threading.Event, seconds: float) -> None:
        """Wait, where accounts are proved by certificates only until main shuts out others."""
        if self._accounts is None:
            stopping.wait(seconds)
            return
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0 and not stopping.wait(min(left, SHUT_SECONDS)):
            if self._accounts.has_news():
                return

    def step(self) -> None:
        """Look at all of them once, and put right what is due. A problem is logged when it is another one."""
        try:
            self._keep()
        except RobotKubeError as error:
            self.failed += 1
            if str(error) != self.problem:
                log.warning("certificates: not all are as they should be: %s", error)
            self.problem = str(error)
            return
        self.problem = ""

    def _keep(self) -> None:
        authority = self._authority()
        for namespace in self._issuance.namespaces:  # first whom to trust, then what is to be trusted
            if self._objects.trusted(namespace) != authority.certificate:
                self._objects.publish(namespace, authority.certificate)
                self.published += 1
                log.info("authority published namespace=%s", namespace)
        self._keep_servers(authority)
        if self._accounts is not None:
            self._accounts.keep(authority, lambda: self._keep_servers_meanwhile(authority))

    def _keep_servers(self, authority: Pair) -> None:
        self._servers_at = self._wall()
        for certificate in self._issuance.certificates:
            self.lives[certificate.secret] = self._renewed(certificate, authority)

    def _keep_servers_meanwhile(self, authority: Pair) -> None:
        """Look at servers as often as between two looks at everything: those of a fleet's accounts are due all at once,
        and servers whose certificate ends meanwhile would be reached by nobody. What fails is met by the next look."""
        if abs(self._wall() - self._servers_at) < self._interval:
            return
        try:
            self._keep_servers(authority)
        except RobotKubeError as error:
            log.warning("certificates: not all are as they should be: %s", error)

    def _authority(self) -> Pair:
        authority = self._objects.authority()
        if authority is None:
            authority = self._issuer.new_authority(AUTHORITY_NAME, self._wall())
            self._objects.keep_authority(authority)
            log.info("authority made")
        elif not self._issuer.is_authority(authority):
            raise InputError(
                f"Secret {self._issuance.authority}: its certificate signs no others, or its key is another one; "
                "bring back the Secret, or empty it: then another authority is made, and everybody has to trust that"
            )
        return authority

    def _renewed(self, certificate: ServerCertificate, authority: Pair) -> Life:
        """The life of a server's certificate, renewed where that is due."""
        secret = certificate.secret
        now = self._wall()
        addresses = self._objects.addresses(certificate.service) if certificate.service else ()
        names = (*certificate.names, *(address for address in addresses if address not in certificate.names))
        present = self._objects.certificate(secret)
        life = self._described(secret, present, authority) if present is not None else None
        reason = reason_to_replace(life, names, now)
        if not reason:
            assert life is not None
            return life
        made = self._issuer.issue(authority, names, now, certificate.seconds)
        self._objects.put_certificate(secret, made)
        self.issued += 1
        life = self._issuer.describe(made, authority)
        cause = reason.replace(" ", "-")
        log.info("certificate issued secret=%s cause=%s seconds=%.0f", secret, cause, life.end - now)
        return life

    def _described(self, secret: str, present: Pair, authority: Pair) -> Life | None:
        """The life of a certificate; None for one that cannot be read: it is replaced as if there were none."""
        try:
            return self._issuer.describe(present, authority)
        except InputError as error:
            log.warning("Secret %s: %s", secret, error)
            return None

    def reasons_not_ready(self) -> Sequence[str]:
        """Why this is not ready: what the last look met, or a certificate that is over."""
        if self.problem:
            return [self.problem]
        now = self._wall()
        ended = [secret for secret, life in self.lives.items() if now >= life.end]
        accounts = self._accounts.lives if self._accounts is not None else {}
        if self._accounts is not None and self._accounts.problem:
            return [self._accounts.problem]
        return [
            *(f"the certificate in Secret {secret} has expired" for secret in ended),
            *(f"the certificate of account {name} has expired" for name, life in accounts.items() if now >= life.end),
        ]

    def accounts_page(self) -> Mapping[str, Any]:
        """The document of GET /accounts: how long the certificate of each account holds, and what the last look met;
        `accounts` is null before the first one, and where accounts have none."""
        accounts = self._accounts
        problem = self.problem or (accounts.problem if accounts is not None else "")
        return {"problem": problem, "accounts": accounts.as_json() if accounts is not None else None}

    def metrics(self) -> Sequence[Series]:
        """What Prometheus reads."""
        prefix = "robotkube_certificates_"
        expiry = "Time at which a certificate expires, in seconds since 1970; 0 while it was not looked at."
        issued, published = "Certificates that were made.", "Namespaces that were told whom to trust."
        ends = {certificate.secret: 0.0 for certificate in self._issuance.certificates}
        ends |= {secret: life.end for secret, life in self.lives.items()}
        accounts = self._accounts
        more: tuple[Series, ...] = ()
        if accounts is not None:
            revoked = "Certificates of accounts that were revoked."
            more = (Series(f"{prefix}revoked_total", "counter", revoked, {(): float(accounts.revoked)}),)
            ends |= {f"{one.namespace}/{one.secret}": life.end for one, life in accounts.standing()}
        made = float(self.issued + (accounts.issued if accounts is not None else 0))
        return (
            *more,
            Series(f"{prefix}expiry_timestamp_seconds", "gauge", expiry, by_one(ends), ("secret",)),
            Series(f"{prefix}issued_total", "counter", issued, {(): made}),
            Series(f"{prefix}published_total", "counter", published, {(): float(self.published)}),
            Series(f"{prefix}failures_total", "counter", "Looks that failed.", {(): float(self.failed)}),
        )
