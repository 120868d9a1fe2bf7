"""Whether the cluster shows what a plan wrote: the Argo CD Application's fields that matter, and the rule over them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class ApplicationState:
    """The part of an Argo CD Application that decides. `source`, `compared_source`, `synced_source` are compared as a
    whole; `plan` is its annotation robotkube.io/plan; `conditions` are its messages for people."""

    name: str
    plan: str = ""
    source: Mapping[str, Any] = field(default_factory=dict)
    compared_source: Mapping[str, Any] = field(default_factory=dict)
    synced_source: Mapping[str, Any] = field(default_factory=dict)
    phase: str = ""
    sync: str = ""
    health: str = ""
    conditions: tuple[str, ...] = ()
    deleting: bool = False


@dataclass(frozen=True)
class PodState:
    """A pod of a release: `deleting` when it has a deletion time, `node_silent_seconds` the age of its node's lease."""

    namespace: str
    name: str
    release: str
    node: str = ""
    deleting: bool = False
    node_silent_seconds: float = 0.0
