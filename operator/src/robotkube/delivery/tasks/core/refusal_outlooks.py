"""Outlooks of refused tasks: what becomes of one that was refused, said with the refusal."""

from __future__ import annotations

from robotkube.delivery.tasks.core.task_description import (
    INVALID_PARAMETERS,
    LEASE_EXPIRED,
    SETTLED_REASONS,
    SUPERSEDED,
)

_STANDS = "This stands until its spec changes; the task stays until it is withdrawn"
_RENEWABLE = "The task stays: renew its lease, or withdraw it"
_CORRECTABLE = (
    "The task stays, and nothing runs for it; it is decided again when its spec or the catalogue changes; withdraw it "
    "when it shall not"
)
_DECIDED_AGAIN = (
    "The task stays, and is decided again when the catalogue, the nodes or other tasks change: it may run then; "
    "withdraw it when it shall not"
)


def outlook(reason: str) -> str:
    """What becomes of a task that was refused for this reason: a sentence without its full stop, or nothing."""
    if reason in SETTLED_REASONS:
        return _STANDS
    return {LEASE_EXPIRED: _RENEWABLE, INVALID_PARAMETERS: _CORRECTABLE, SUPERSEDED: ""}.get(reason, _DECIDED_AGAIN)


def with_outlook(reason: str, message: str, characters_max: int) -> str:
    """The message of a refusal, with what becomes of the task; a long message is cut before that."""
    end = _end(reason)
    room = characters_max - len(end)
    return f"{message if len(message) <= room else f'{message[: room - 1]}…'}{end}"


def without_outlook(reason: str, message: str) -> str:
    """The message of a refusal as it was before `with_outlook`."""
    return message.removesuffix(_end(reason))


def _end(reason: str) -> str:
    words = outlook(reason)
    return f". {words}" if words else ""
