"""Identity of Kubernetes objects: key, uid, and whether one is being deleted."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def object_key(document: Mapping[str, Any]) -> str:
    """`<namespace>/<name>` of any Kubernetes object."""
    metadata = document.get("metadata", {})
    return f"{metadata.get('namespace', '')}/{metadata.get('name', '')}"


def object_identity(document: Mapping[str, Any]) -> str:
    """Identity of an object, different from that of a later one of the same name."""
    metadata = document.get("metadata", {})
    return f"{metadata.get('uid', '')} {metadata.get('creationTimestamp', '')}"


def is_withdrawn(document: Mapping[str, Any]) -> bool:
    """Return whether the object is being deleted: its demand no longer counts."""
    return bool(document.get("metadata", {}).get("deletionTimestamp"))
