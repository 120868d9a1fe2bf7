"""The message types that the packaged images know, and the words for one that they do not know."""

from __future__ import annotations

from robotkube.robots.ros.core.message_definitions import short_name
from robotkube.robots.ros.core.packaged_types import PACKAGED_TYPES

LISTED = "docs/reference/message-types.md"
"""Where people find the list."""

_KNOWN = frozenset(f"{package}/{name}" for package, names in PACKAGED_TYPES.items() for name in names.split())
_OF_TEXT = "std_msgs/msg/String carries any text"


def is_packaged(type_name: str) -> bool:
    """Return whether the packaged images know the type; False for what is none."""
    try:
        return short_name(type_name) in _KNOWN
    except ValueError:
        return False


def unknown_type(type_name: str) -> str:
    """The reason why the packaged images do not know the type: its package, or the message in it."""
    package, _, name = type_name.partition("/msg/")
    if package not in PACKAGED_TYPES:
        return f"type {type_name}: none of the packaged images has the message package {package}"
    like = sorted(known for known in PACKAGED_TYPES[package].split() if known.lower().startswith(name[:4].lower()))
    meant = f" (it has {', '.join(like)})" if like else ""
    return f"type {type_name}: package {package} has no message {name}{meant}"


def instead() -> str:
    """What to take instead."""
    return f"take a type of {LISTED} ({_OF_TEXT})"
