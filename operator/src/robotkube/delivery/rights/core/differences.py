"""The difference between what the broker has and what it shall have, as requests, each with its words."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.rights.core.control import DEFAULTS, SEND, Client, Entry, Standing, modify_role

ENTRIES_NAMED_MAX = 4


@dataclass(frozen=True)
class RightsChange:
    """One request, whose account or other thing it is about, and what stands there, in words."""

    request: Mapping[str, Any]
    about: str
    was: str


def role_changes(standing: Standing, wanted: Mapping[str, frozenset[Entry]]) -> list[RightsChange]:
    """Lists that differ: these change by themselves when main does, and disconnect nobody."""
    return [
        RightsChange(modify_role(name, listed), name, _compared(standing.roles[name], listed))
        for name, listed in sorted(wanted.items())
        if name in standing.roles and standing.roles[name] != listed
    ]


def never_given(standing: Standing, wanted: Mapping[str, frozenset[Entry]]) -> list[RightsChange]:
    """Lists that differ by what no link ever gives: a right to write, a filter of everything below, a refusal."""
    return [
        change
        for change in role_changes(standing, wanted)
        if any(
            kind == SEND or "#" in topic or not allow
            for kind, topic, allow in standing.roles[change.about] - wanted[change.about]
        )
    ]


def foreign_changes(standing: Standing, wanted: Mapping[str, frozenset[Entry]]) -> Iterator[RightsChange]:
    """What only somebody else can have made: accounts, roles, groups and defaults that are not ours. Clients that it is
    about are disconnected by this."""
    if dict(standing.defaults) != DEFAULTS:
        acls = [{"acltype": kind, "allow": allow} for kind, allow in DEFAULTS.items()]
        yield RightsChange({"command": "setDefaultACLAccess", "acls": acls}, "defaults", _words(standing.defaults))
    if standing.anonymous:
        request = {"command": "setAnonymousGroup", "groupname": ""}
        yield RightsChange(request, "anonymous", f"whoever names no account is in group {standing.anonymous}")
    for name in sorted(set(wanted) - set(standing.roles)):
        yield RightsChange(
            {**modify_role(name, wanted[name]), "command": "createRole"}, name, "no role of the account's name"
        )
    for name, client in sorted(standing.clients.items()):
        yield from _client_changes(name, client, name in wanted)
    for group in standing.groups:
        yield RightsChange({"command": "deleteGroup", "groupname": group}, group, "a group that is not ours")
    for role in sorted(set(standing.roles) - set(wanted)):
        yield RightsChange({"command": "deleteRole", "rolename": role}, role, "a role that is not ours")


def access_changes(standing: Standing, wanted: Collection[str], revoked: Collection[str] | None) -> list[RightsChange]:
    """Accounts that stand open though they are revoked, whose connections end by this, and those that are shut though
    they are not. None are changed while it is not known who is `revoked`."""
    if revoked is None:
        return []
    changes = []
    for name in sorted(set(wanted) & set(standing.clients)):
        if standing.clients[name].disabled != (name in revoked):
            command, was = ("disableClient", "open") if name in revoked else ("enableClient", "disabled")
            changes.append(RightsChange({"command": command, "username": name}, name, f"an account that was {was}"))
    return changes


def endings(standing: Standing, revoked: Collection[str] | None) -> list[Mapping[str, Any]]:
    """The requests that end what `revoked` accounts have connected once more: a certificate lets them do that, without
    rights, until the broker knows that it is revoked. A change that changes nothing disconnects; to shut the account
    again could hide that another hand has opened it since it was read."""
    shut = [name for name in sorted(revoked or ()) if name in standing.clients and standing.clients[name].disabled]
    return [{"command": "modifyClient", "username": name} for name in shut]


def missing(standing: Standing, wanted: Mapping[str, frozenset[Entry]]) -> list[str]:
    """Accounts that the broker does not have: their passwords are with its pod alone, which makes accounts anew when it
    starts."""
    return sorted(set(wanted) - set(standing.clients))


def _client_changes(name: str, client: Client, ours: bool) -> Iterator[RightsChange]:
    if not ours:
        yield RightsChange({"command": "deleteClient", "username": name}, name, "an account that is not ours")
        return
    if client.roles != (name,) or client.groups:
        held = ", ".join((*client.roles, *(f"group {group}" for group in client.groups))) or "none"
        request = {"command": "modifyClient", "username": name, "roles": [{"rolename": name}], "groups": []}
        yield RightsChange(request, name, f"an account with the roles {held}")


def _compared(had: frozenset[Entry], wanted: frozenset[Entry]) -> str:
    parts = [(word, sorted(some)) for word, some in (("besides", had - wanted), ("without", wanted - had)) if some]
    return "; ".join(f"{word} {_named(some)}" for word, some in parts)


def _named(some: list[Entry]) -> str:
    shown = ", ".join(f"{'' if allow else 'not '}{kind} {topic}" for kind, topic, allow in some[:ENTRIES_NAMED_MAX])
    return shown + (f" and {len(some) - ENTRIES_NAMED_MAX} more" if len(some) > ENTRIES_NAMED_MAX else "")


def _words(defaults: Mapping[str, bool]) -> str:
    return ", ".join(f"{kind} {'allowed' if allow else 'refused'}" for kind, allow in sorted(defaults.items()))
