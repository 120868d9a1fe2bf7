"""What is issued: for which names, for how long, where it stands, and who is told whom to trust."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Issuance:
    """The broker's certificate in the Secret `certificate` of namespace `platform`, for `names` and `seconds`; its
    authority in Secret `authority` there, and what is public of that in ConfigMap `trusted` of all `namespaces`."""

    platform: str
    authority: str
    certificate: str
    trusted: str
    namespaces: tuple[str, ...]
    names: tuple[str, ...]
    seconds: float
