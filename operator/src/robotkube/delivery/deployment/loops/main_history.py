"""Main's history: its files as they stood before, and the terms of its managers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from robotkube.delivery.deployment.core.commit_messages import read_message
from robotkube.delivery.deployment.core.releases import RELEASES, SOURCES
from robotkube.delivery.deployment.core.repairs import HISTORY_COMMITS_MAX
from robotkube.errors import DocumentError
from robotkube.foundation.forge.core.trailers import claims
from robotkube.foundation.forge.ports.repositories import MainHistory

POLICIES = "policies"
TERM_COMMITS_MAX = 10_000  # how far back a manager's last term is searched
NOT_TEXT = "\0"  # stands for a file that is no ordinary text: it cannot be read, but it is there


def release_files(repository: MainHistory, commit: str) -> dict[str, str]:
    """The files of releases/ and sources/ in a commit; one that is no text has a content that nobody can read, so that
    it cannot look as if it were gone."""
    folders = (RELEASES, SOURCES)
    return {
        **repository.files(commit, folders),
        **dict.fromkeys(repository.irregular(commit, folders), NOT_TEXT),
    }


def policy_files(repository: MainHistory, commit: str) -> dict[str, str]:
    """The files of policies/ in a commit; one that is no text has a content that nobody can read."""
    folders = (POLICIES,)
    return {
        **repository.files(commit, folders),
        **dict.fromkeys(repository.irregular(commit, folders), NOT_TEXT),
    }


def older_files(repository: MainHistory) -> Iterator[Mapping[str, str]]:
    """The same files in the commits before main's tip, newest first, at most HISTORY_COMMITS_MAX."""
    for index, (commit, _) in enumerate(repository.headers("", HISTORY_COMMITS_MAX + 1)):
        if index:
            yield release_files(repository, commit)


class Terms:
    """The highest term of every manager on main; read once, then kept up with it."""

    def __init__(self, repository: MainHistory, managers: Iterable[str]) -> None:
        self._repository = repository
        self._managers = frozenset(managers)
        self._last: dict[str, int] = {}
        self._tip = ""

    def last(self, manager: str, tip: str) -> int:
        """The manager's highest term while main stands at `tip`; 0 when it has none there."""
        if tip != self._tip:
            self._read(tip)
        return self._last.get(manager, 0)

    def _read(self, tip: str) -> None:
        missing = set(self._managers) if not self._tip else set[str]()
        for _, text in self._repository.headers(self._tip, TERM_COMMITS_MAX):
            signature = term_of(text)
            if signature is not None:
                manager, term = signature
                self._last[manager] = max(term, self._last.get(manager, 0))
                missing.discard(manager)
                if not self._tip and not missing:
                    break
        self._tip = tip


def term_of(text: str) -> tuple[str, int] | None:
    """The manager and the term in a plan's commit message; None when it is no plan's."""
    if not claims(text, "Term"):
        return None
    try:
        message = read_message(text)
    except DocumentError:
        return None
    return message.manager, message.term
