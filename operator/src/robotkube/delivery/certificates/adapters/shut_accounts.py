"""The port ShutAccounts: a page of the process `rights`, which knows main. Its certificate is of the authority that
this process keeps, so nobody has to bring that here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.adapters.certificate_authorities import trust_text


class ReadingPages(Protocol):
    """The call needed of `foundation.pages.adapters.http_pages.HttpPages`."""

    def get(self, url: str) -> Mapping[str, Any]:
        """The JSON object at an address."""
        ...


class ShutAccountsPage:
    """The names in the list `shut` of the page at `url`."""

    def __init__(self, pages: ReadingPages, url: str) -> None:
        self._pages = pages
        self._url = url

    def shut(self, authority: str) -> frozenset[str]:
        """See the port."""
        trust_text(authority)
        try:
            listed = self._pages.get(self._url).get("shut")
        except InputError as error:  # another version of that process, which has no such page
            raise UnavailableError(f"{self._url}: {error}") from error
        if not isinstance(listed, list) or not all(isinstance(name, str) for name in listed):
            raise UnavailableError(f"{self._url}: no list of accounts under `shut`")
        return frozenset(listed)
