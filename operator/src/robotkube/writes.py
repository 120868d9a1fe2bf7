"""Every method of an adapter that changes the world outside carries `@writes`: the points at which a process may be
killed are generated from that.

    @writes("git")
    def push_main(self, commit): ...
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, TypeVar

WriteKind = Literal["git", "forge", "lease", "status", "event", "task", "message", "argocd", "workload"]
Method = TypeVar("Method", bound=Callable[..., object])

WRITES: dict[str, WriteKind] = {}
"""`<module>.<class>.<method>` of every write -> what it writes to; filled as the adapters are imported."""


def writes(kind: WriteKind) -> Callable[[Method], Method]:
    """Mark a method that writes to the world; it stays as it is."""

    def mark(method: Method) -> Method:
        WRITES[f"{method.__module__}.{method.__qualname__}"] = kind
        return method

    return mark
