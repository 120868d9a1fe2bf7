"""Answers as JSON text: put together of the texts that the table has made already, so that nothing is encoded twice."""

from __future__ import annotations

import json
from collections.abc import Mapping

from robotkube.delivery.console.core.table import TableChange, resume_id


def snapshot_text(whole: TableChange, epoch: str, now_ms: int, links: Mapping[str, str]) -> str:
    """The document of a snapshot."""
    head = _members(
        id=json.dumps(resume_id(epoch, whole.version)),
        version=str(whole.version),
        epoch=json.dumps(epoch),
        time_ms=str(now_ms),
        links=json.dumps(dict(links)),
        items=_items(whole),
    )
    return f"{{{head}}}"


def change_text(change: TableChange, epoch: str, now_ms: int) -> str:
    """The document of a change."""
    members = _members(
        id=json.dumps(resume_id(epoch, change.version)),
        version=str(change.version),
        time_ms=str(now_ms),
        set=_items(change),
        gone=json.dumps(change.gone, separators=(",", ":")),
    )
    return f"{{{members}}}"


def items_text(items: Mapping[str, str]) -> str:
    """The object of these items, by key."""
    return f"{{{','.join(f'{json.dumps(key)}:{text}' for key, text in items.items())}}}"


def _items(change: TableChange) -> str:
    kinds = (f"{json.dumps(kind)}:{items_text(items)}" for kind, items in change.items.items())
    return f"{{{','.join(kinds)}}}"


def _members(**members: str) -> str:
    return ",".join(f'"{name}":{text}' for name, text in members.items())
