"""The forge that a process uses: the key `forge` of its settings, and the adapters for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robotkube.foundation.certificates.settings import read_authorities
from robotkube.foundation.documents.core.entry_reader import read_one_of
from robotkube.foundation.documents.core.patterns import HTTP_URL, REPOSITORY, WORD
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.forge.adapters.git import GitClone, ProposalWriter
from robotkube.foundation.forge.adapters.hosts import github, gitlab
from robotkube.foundation.forge.adapters.hosts.gitea import GiteaForge
from robotkube.foundation.forge.core.commit_objects import CommitObjects
from robotkube.foundation.runtime import settings_file as files

GITEA, GITHUB, GITLAB = "gitea", "github", "gitlab"
HEADS = {GITEA: "refs/pull/{}/head", GITHUB: "refs/pull/{}/head", GITLAB: "refs/merge-requests/{}/head"}

AnyForge = GiteaForge | github.GitHubForge | gitlab.GitLabForge


@dataclass(frozen=True)
class ForgeAddress:
    """The address of a forge: `url` is where Git is spoken; `api` where GitHub's or GitLab's API is when it is not
    their public one, `authorities` a file with those that may have signed its certificate besides the usual ones."""

    url: str
    kind: str = GITEA
    api: str = ""
    authorities: Path | None = None

    def clone(self, repository: str, account: files.Credentials, folder: Path, branch: str) -> GitClone:
        """A bare clone of `<organisation>/<name>` in `folder`."""
        heads = HEADS[self.kind]
        return GitClone(self.url, repository, account.username, account.password, folder, branch=branch, heads=heads)

    def pull_requests(self, repository: str, account: files.Credentials, branch: str) -> AnyForge:
        """The port Forge for `<organisation>/<name>`; for GitHub and GitLab the password is an access token."""
        if self.kind == GITHUB:
            return github.GitHubForge(repository, account.password, self.api or github.API, branch=branch)
        if self.kind == GITLAB:
            return gitlab.GitLabForge(repository, account.password, self.api or gitlab.API, branch=branch)
        return GiteaForge(self.url, repository, account.username, account.password, branch=branch)

    def writer(
        self,
        forge: AnyForge,
        folder: Path,
        account: files.Credentials,
        author: str,
        clock: Callable[[], float],
        branch: str,
        send_objects: Callable[[CommitObjects], None] | None = None,
    ) -> ProposalWriter:
        """The port Proposals on the clone in `folder`: by AGit where `forge` supports that, else by branches."""
        opens = None if isinstance(forge, GiteaForge) else forge.open_pull_request
        return ProposalWriter(folder, account.username, account.password, author, clock, branch, opens, send_objects)


@dataclass(frozen=True)
class ForgeSettings:
    """A forge as one process uses it: by its account there, the branch `branch` of these repositories. One that a
    process does not use is empty."""

    address: ForgeAddress
    account: files.Credentials
    branch: str
    catalogue: str = ""
    deployment: str = ""

    def clone(self, repository: str, folder: Path) -> GitClone:
        """A bare clone of `<organisation>/<name>` in `folder`."""
        return self.address.clone(repository, self.account, folder, self.branch)

    def pull_requests(self, repository: str) -> AnyForge:
        """The port Forge for `<organisation>/<name>`."""
        return self.address.pull_requests(repository, self.account, self.branch)


def read_forge(
    reader: Reader,
    value: Any,
    deployment: bool = True,
    more: Iterable[str] = (),
    catalogue: bool = True,
) -> ForgeSettings:
    """The settings' `forge`, with the keys `deployment` and `catalogue` or without; `more` are keys that the caller
    reads."""
    repositories = [*(["catalogue"] if catalogue else []), *(["deployment"] if deployment else [])]
    forge = reader.mapping(
        value or {}, "forge", ["url", "credentials", "branch", *repositories, *more], ["kind", "api", "authorities"]
    )
    names = {key: reader.word(forge.get(key), f"forge.{key}", REPOSITORY) for key in repositories}
    return ForgeSettings(
        address=_address(reader, forge),
        account=files.credentials(reader, forge.get("credentials"), "forge.credentials"),
        branch=reader.word(forge.get("branch"), "forge.branch", WORD),
        **names,
    )


def _address(reader: Reader, forge: Mapping[str, object]) -> ForgeAddress:
    return ForgeAddress(
        reader.word(forge.get("url"), "forge.url", HTTP_URL),
        read_one_of(reader, forge.get("kind", GITEA), "forge.kind", (GITEA, GITHUB, GITLAB)),
        reader.word(forge.get("api"), "forge.api", HTTP_URL, default=""),
        read_authorities(reader, forge, "forge"),
    )
