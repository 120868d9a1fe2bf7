"""The key that signs evidence: made once, by who can write its Secret and not read it.

The public half is published before the Secret is made, in every namespace that verifies. So whatever interrupts this,
the public half of the key in the Secret is known; a public key whose private half was never kept signs nothing.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

from robotkube.errors import InputError
from robotkube.registry.evidence.core.key_pairs import KeyPair
from robotkube.setup.ports import GateKeyObjects

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Provided:
    """What came of it: `origin` is `kept` (it was there), `moved` (from where the gate stood before) or `made`;
    `trusted` counts the public keys that are published."""

    origin: str
    trusted: int


def provide_key(objects: GateKeyObjects, former: KeyPair | None, make: Callable[[], KeyPair]) -> Provided:
    """Have a key in the Secret and its public half in every ConfigMap: the one that is there, else `former`, else a new
    one. InputError when there is a key whose public half nobody knows."""
    if objects.has_key():
        return _kept(objects, former)
    key = former or make()
    name = file_name(key)
    _publish(objects, {name: key.public})
    if objects.keep(key.private):
        return Provided("moved" if former else "made", len(_published(objects)))
    for namespace in objects.public_keys():
        objects.withdraw(namespace, name)
    log.warning("another Job has made the key meanwhile: its key stays key=%s", key.key_id)
    return Provided("kept", len(_published(objects)))


def file_name(key: KeyPair) -> str:
    """Of its public half, in ConfigMaps and in folders of trusted keys."""
    return f"gate-{key.key_id}.pem"


def _kept(objects: GateKeyObjects, former: KeyPair | None) -> Provided:
    known = _published(objects)
    if not known:
        places = ", ".join(objects.public_keys())
        raise InputError(
            f"there is a key, but no ConfigMap (of namespaces {places}) says whose signatures count, and this account "
            "cannot read the key. As administrator, write the key's public half into one of them, as "
            "docs/reference/charts.md says below `The key that signs evidence`"
        )
    _publish(objects, known)
    if former and file_name(former) in known:
        log.warning("the same key stands where the gate was before: remove it there key=%s", former.key_id)
    elif former:
        log.warning("another key stands where the gate was before: it signs nothing key=%s", former.key_id)
    return Provided("kept", len(known))


def _published(objects: GateKeyObjects) -> dict[str, str]:
    """The public keys of all namespaces."""
    return {name: pem for keys in objects.public_keys().values() for name, pem in keys.items()}


def _publish(objects: GateKeyObjects, keys: dict[str, str]) -> None:
    """Write what is missing: a namespace that has lost its ConfigMap gets it again from the others."""
    wanted = {**_published(objects), **keys}
    for namespace, present in objects.public_keys().items():
        missing = {name: pem for name, pem in wanted.items() if present.get(name) != pem}
        if missing:
            objects.publish(namespace, missing)
