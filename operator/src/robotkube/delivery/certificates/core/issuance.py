"""What is issued: for which names, for how long, where it stands, and who is told whom to trust."""

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
class Issuance:
    """The certificates of servers, each in a Secret with a name of its own; their authority in Secret `authority` of
    namespace `platform`, and what is public of that in ConfigMap `trusted` of all `namespaces`."""

    platform: str
    authority: str
    trusted: str
    namespaces: tuple[str, ...]
    certificates: tuple[ServerCertificate, ...]
