"""mosquitto's dynamic security: rights as its access control lists, its first file, requests and answers.

Facts of its version 2.0: `modifyRole` with a whole list changes what clients may at once and disconnects nobody, while
adding a single entry, a role, or changing a client does; a subscription that stands gets nothing more once the right
to receive is gone, as long as every default is to refuse (all but unsubscribing here). Every account has one role, of
its own name, and no group.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.delivery.rights.core.accounts import ASK, OWNER, READ, WRITE, Right, Table

REQUESTS = "$CONTROL/dynamic-security/v1"
RESPONSES = "$CONTROL/dynamic-security/v1/response"
SEND, RECEIVE, SUBSCRIBE = "publishClientSend", "publishClientReceive", "subscribePattern"
DEFAULTS = {"publishClientSend": False, "publishClientReceive": False, "subscribe": False, "unsubscribe": True}
OWNER_RIGHTS = frozenset([Right(REQUESTS, WRITE), Right(RESPONSES, READ)])
PAGE_ROLES = 8

Document = Mapping[str, Any]
Entry = tuple[str, str, bool]
"""One entry of a list: its type, the topic, and whether it allows."""


@dataclass(frozen=True)
class Password:
    """A password as the plugin keeps it: base64 of PBKDF2-HMAC-SHA512 and of the salt."""

    digest: str
    salt: str
    iterations: int


@dataclass(frozen=True)
class Client:
    """An account as it stands at the broker."""

    roles: tuple[str, ...]
    groups: tuple[str, ...] = ()
    disabled: bool = False


@dataclass(frozen=True)
class Standing:
    """All that the broker has: lists by role, accounts, groups, defaults, and the group of who names no account."""

    roles: Mapping[str, frozenset[Entry]]
    clients: Mapping[str, Client]
    groups: tuple[str, ...] = ()
    defaults: Mapping[str, bool] = field(default_factory=lambda: dict(DEFAULTS))
    anonymous: str = ""


def entries(rights: Iterable[Right]) -> frozenset[Entry]:
    """The list of an account."""
    types = {WRITE: (SEND,), READ: (SUBSCRIBE, RECEIVE), ASK: (SUBSCRIBE,)}
    return frozenset((kind, right.topic, True) for right in rights for kind in types[right.direction])


def wanted_roles(table: Table) -> dict[str, frozenset[Entry]]:
    """The lists that the broker shall have."""
    return {**{name: entries(rights) for name, rights in table.items()}, OWNER: entries(OWNER_RIGHTS)}


def role_document(name: str, listed: Iterable[Entry]) -> dict[str, Any]:
    """A role with its whole list."""
    acls = [{"acltype": kind, "topic": topic, "priority": 0, "allow": allow} for kind, topic, allow in sorted(listed)]
    return {"rolename": name, "acls": acls}


def first_file(table: Table, passwords: Mapping[str, Password], before: Any, agents: Collection[str]) -> dict[str, Any]:
    """The file that the broker begins with: accounts and passwords anew, and of those that are still there the lists
    that they had `before`, if they had any, and whether they were shut; the owner's is always anew. Of `agents` those
    that were not there begin shut: whom main lets in, the owner opens."""
    had = _roles_of(before)
    shut = _shut_in(before) | (frozenset(agents) - _open_in(before))
    roles = wanted_roles(table)
    kept = {name: had[name] for name in roles if name in had and name != OWNER}
    return {
        "defaultACLAccess": DEFAULTS,
        "clients": [_client(name, passwords[name], name in shut) for name in sorted(roles)],
        "roles": [role_document(name, kept.get(name, listed)) for name, listed in sorted(roles.items())],
    }


def _client(name: str, password: Password, shut: bool) -> dict[str, Any]:
    return {
        **({"disabled": True} if shut and name != OWNER else {}),
        "username": name,
        "password": password.digest,
        "salt": password.salt,
        "iterations": password.iterations,
        "roles": [{"rolename": name}],
    }


def _roles_of(document: Any) -> Mapping[str, frozenset[Entry]]:
    """The lists in a file of the plugin; none when it is not one."""
    try:
        return _read_roles(document["roles"])
    except (KeyError, TypeError, AttributeError):
        return {}


def _shut_in(document: Any) -> frozenset[str]:
    """The accounts that are shut in a file of the plugin; none when it is not one."""
    return frozenset(name for name, shut in _accounts_in(document).items() if shut)


def _open_in(document: Any) -> frozenset[str]:
    """The accounts that are open in a file of the plugin; none when it is not one."""
    return frozenset(name for name, shut in _accounts_in(document).items() if not shut)


def _accounts_in(document: Any) -> Mapping[str, bool]:
    """Return whether each account in a file of the plugin is shut; none when it is not one."""
    try:
        return {one["username"]: bool(one.get("disabled")) for one in document["clients"]}
    except (KeyError, TypeError, AttributeError):
        return {}


def _read_roles(items: Sequence[Document]) -> dict[str, frozenset[Entry]]:
    return {
        item["rolename"]: frozenset((acl["acltype"], acl["topic"], bool(acl["allow"])) for acl in item.get("acls", ()))
        for item in items
    }


def modify_role(name: str, listed: Iterable[Entry]) -> dict[str, Any]:
    """The request that gives a role its whole list."""
    return {"command": "modifyRole", **role_document(name, listed)}


def role_pages(count: int) -> list[dict[str, Any]]:
    """The requests for `count` roles with their lists, each answered by a message of bounded size."""
    return [
        {"command": "listRoles", "verbose": True, "count": PAGE_ROLES, "offset": offset}
        for offset in range(0, max(count, 1), PAGE_ROLES)
    ]


STATE = (
    {"command": "listRoles", "verbose": False, "count": -1, "offset": 0},
    {"command": "listClients", "verbose": True, "count": -1, "offset": 0},
    {"command": "listGroups", "verbose": False, "count": -1, "offset": 0},
    {"command": "getDefaultACLAccess"},
    {"command": "getAnonymousGroup"},
)
"""The requests for everything but lists; answers in the same order."""


def read_standing(state: Sequence[Document], pages: Sequence[Document]) -> Standing:
    """What the answers to STATE and to the pages of roles say; KeyError or TypeError when they are not such answers."""
    _, clients, groups, defaults, anonymous = (answer.get("data", {}) for answer in state)
    return Standing(
        roles={name: listed for page in pages for name, listed in _read_roles(page["data"]["roles"]).items()},
        clients={one["username"]: _read_client(one) for one in clients["clients"]},
        groups=tuple(groups["groups"]),
        defaults={one["acltype"]: bool(one["allow"]) for one in defaults["acls"]},
        anonymous=str(anonymous.get("group", {}).get("groupname") or ""),
    )


def _read_client(document: Document) -> Client:
    return Client(
        tuple(one["rolename"] for one in document.get("roles", ())),
        tuple(one["groupname"] for one in document.get("groups", ())),
        bool(document.get("disabled", False)),
    )
