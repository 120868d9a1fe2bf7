"""What is issued: for which names and accounts, for how long, where it stands, and who is told whom to trust."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ServerCertificate:
    """The certificate of one server in the Secret `secret`, for `names` and `seconds`; with `service`, also for the
    addresses that this Service has in the cluster. The Secret stands in `namespace`, or empty: in the platform's."""

    secret: str
    names: tuple[str, ...]
    seconds: float
    service: str = ""
    namespace: str = ""


@dataclass(frozen=True)
class AccountCertificate:
    """The certificate by which an account at the broker is proved, in the Secret that has the account. Another `number`
    makes another one, and revokes those before; the one of a `reserved` account is made when main lets it in."""

    account: str
    secret: str
    namespace: str
    number: int = 0
    reserved: bool = False


@dataclass(frozen=True)
class AccountIssuance:
    """The certificates of accounts, each for `seconds`; ConfigMap `register` of the platform's namespace has what was
    issued and the list of those that are revoked, the page `shut` who may not be at the broker."""

    certificates: tuple[AccountCertificate, ...]
    seconds: float
    register: str
    shut: str


@dataclass(frozen=True)
class Issuance:
    """The certificates of servers, each in a Secret with a name of its own; their authority in Secret `authority` of
    namespace `platform`, and what is public of that in ConfigMap `trusted` of all `namespaces`. `accounts`: where
    accounts are proved by certificates."""

    platform: str
    authority: str
    trusted: str
    namespaces: tuple[str, ...]
    certificates: tuple[ServerCertificate, ...]
    accounts: AccountIssuance | None = None
