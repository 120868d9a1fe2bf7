"""The repair of a broken main: each file that cannot be read or contradicts another, as it was in good order.

One malformed, empty or doubly named release file stops all of Argo CD's releases. Manager and gate compute the same
repair from the same history, so that the gate can merge it alone: it brings nothing that was not on main before.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from robotkube.delivery.deployment.core.releases import read_tree

HISTORY_COMMITS_MAX = 200  # how far back a good main is searched; beyond that, what is broken is removed
ROUNDS_MAX = 10  # a file put back may contradict one that seemed good


def repair(files: Mapping[str, str], history: Iterable[Mapping[str, str]]) -> dict[str, str | None]:
    """The changes that make `files` of releases/ and sources/ readable: path -> text, None removes; empty when they
    are.

    `history` are the same folders in the commits before, newest first. A path goes back to its content in the newest
    one that was good as a whole; when there is none, or the path was not there, it goes."""
    now = dict(files)
    changes: dict[str, str | None] = {}
    if not read_tree(now).problems:
        return changes
    good = next((older for older in history if not read_tree(older).problems), {})
    for _ in range(ROUNDS_MAX):
        tree = read_tree(now)
        wanted = {path: good.get(path) for path in tree.suspects if now.get(path) != good.get(path)}
        if not wanted:
            return changes
        changes |= wanted
        now = {path: text for path, text in {**now, **wanted}.items() if text is not None}
    return changes
