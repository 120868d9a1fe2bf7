"""The changes that may be made although people edited releases on main by hand."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from robotkube.delivery.manager.core.plans import Change, fingerprint


def respected(changes: Iterable[Change], edits: Mapping[str, str], first: dict[str, str]) -> tuple[Change, ...]:
    """The changes that may be made although people edited `edits` (path -> their commit) by hand.

    `first` remembers what was wanted of an edited release when its last edit was first seen (path -> that edit's commit
    and the change's fingerprint, or that none was wanted), and is brought up to date: an edit stands as long as that
    stays the same."""
    wanted = {change.path: change for change in changes}
    wishes = {path: f"{commit} {_wish(wanted.get(path))}" for path, commit in edits.items()}
    for path in [path for path in first if path not in edits]:
        del first[path]
    for path, wish in wishes.items():
        if not first.get(path, "").startswith(f"{edits[path]} "):
            first[path] = wish
    return tuple(change for path, change in wanted.items() if path not in edits or first[path] != wishes[path])


def _wish(change: Change | None) -> str:
    return "" if change is None else fingerprint([change])
