"""The parts that clones, proposals and notes share: a bare clone on disk, its connection to the forge, commits by
id."""

from __future__ import annotations

import contextlib
import ipaddress
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pygit2
from pygit2.enums import FetchPrune

from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.certificate_authorities import changed_at, refusal_of, trusted
from robotkube.foundation.runtime.adapters.asking_again import ask_again

TIMEOUT_MILLISECONDS = 10_000
SERVER_OUTPUT_CHARACTERS_MAX = 16_384
EMAIL_DOMAIN = "robotkube.invalid"
BY_ADDRESS = (
    "Git does not compare addresses with certificates; connect by a name that its certificate has, such as localhost "
    "with a forwarded port, or add one to forge.names"
)

pygit2.settings.server_connect_timeout = TIMEOUT_MILLISECONDS
pygit2.settings.server_timeout = TIMEOUT_MILLISECONDS

ORIGIN = "origin"
ENDED = ("reset by peer", "Broken pipe", "unexpected EOF", "SSL error")  # libgit2's words; it gives no number

_read: dict[Path, int] = {}


def read_authorities() -> None:
    """Have libgit2 believe whom this process trusts, as their files are now, besides the usual authorities."""
    for path in trusted():
        changed = changed_at(path)
        if _read.get(path) != changed:
            pygit2.settings.set_ssl_cert_locations(str(path), None)
            _read[path] = changed


def what_failed(error: Exception, url: str) -> str:
    """What a connection to `url` met, in words. libgit2 does not say why it refused a certificate: that is asked."""
    text = str(error)
    return (refusal_of(url) or text) if "certificate" in text or "SSL" in text else text


def fetch(
    repository: pygit2.Repository,
    specifications: Sequence[str],
    account: tuple[str, str],
    prune: FetchPrune = FetchPrune.UNSPECIFIED,
) -> None:
    """Fetch from where a repository was cloned from, by a connection of its own, and by another one when the forge ends
    that meanwhile: a remote of libgit2 that is used again keeps its connection, also one that has ended. GitError or
    PermissionError: the forge is away or refuses."""

    def once() -> None:
        repository.remotes[ORIGIN].fetch(list(specifications), callbacks=GitConnection(account), prune=prune)

    ask_again(once, _ended_meanwhile)


def _ended_meanwhile(error: Exception) -> bool:
    return isinstance(error, pygit2.GitError) and any(words in str(error) for words in ENDED)


class GitConnection(pygit2.RemoteCallbacks):
    """One connection of an account (name and password). The password is given once: libgit2 would ask for ever. The
    server's other output is in `output`; `refusal` is its reason against a pushed reference, empty when it accepted
    that."""

    def __init__(self, account: tuple[str, str]) -> None:
        super().__init__()
        read_authorities()
        self._account = account
        self._asked = 0
        self.output = self.refusal = ""

    def credentials(self, url: str, username_from_url: str | None, allowed_types: Any) -> Any:
        """Name and password; PermissionError when the forge asks again."""
        self._asked += 1
        if self._asked > 2:
            raise PermissionError(f"the forge refused the password of account {self._account[0]}")
        return pygit2.UserPass(*self._account)

    def certificate_check(self, certificate: None, valid: bool, host: bytes | str) -> bool:
        """libgit2's verdict, but none on an address: it compares those wrongly. InputError names the way out."""
        name = host.decode() if isinstance(host, bytes) else host
        with contextlib.suppress(ValueError):
            ipaddress.ip_address(name)
            raise InputError(f"the forge at {name}: {BY_ADDRESS}")
        raise pygit2.Passthrough

    def sideband_progress(self, string: str) -> None:
        """Keep the newest SERVER_OUTPUT_CHARACTERS_MAX of the server's output."""
        self.output = (self.output + string)[-SERVER_OUTPUT_CHARACTERS_MAX:]

    def push_update_reference(self, refname: str, message: str | None) -> None:
        """Keep why a reference was refused."""
        self.refusal = message or self.refusal


def open_clone(folder: Path, url: str, repository: str) -> pygit2.Repository:
    """The bare clone in `folder`, made when it is not there, of `<organisation>/<name>` at the forge."""
    clone = pygit2.init_repository(str(folder), bare=True)
    if ORIGIN not in list(clone.remotes.names()):
        clone.remotes.create(ORIGIN, f"{url}/{repository}.git")
    clone.remotes.set_url(ORIGIN, f"{url}/{repository}.git")
    return clone


def look_up(repository: pygit2.Repository, commit: str, where: str) -> pygit2.Commit:
    """The commit with that id; InputError, which names `where`, when it is not in the clone or no commit."""
    try:
        git_object = repository[commit]
    except (KeyError, ValueError) as error:
        raise InputError(f"{where}: commit {commit!r} is not here; fetch first") from error
    if not isinstance(git_object, pygit2.Commit):
        raise InputError(f"{where}: {commit!r} is not a commit")
    return git_object
