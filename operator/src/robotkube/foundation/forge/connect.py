"""The forge that a process uses: `forge.kind`, `forge.url`, `forge.api` of its settings, and the adapters for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from robotkube.foundation.documents.core.entry_reader import read_one_of
from robotkube.foundation.documents.core.patterns import HTTP_URL
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
    their public one."""

    url: str
    kind: str = GITEA
    api: str = ""

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


def read_address(reader: Reader, forge: Mapping[str, object]) -> ForgeAddress:
    """The keys `url`, `kind` and `api` of the settings' `forge`."""
    return ForgeAddress(
        reader.word(forge.get("url"), "forge.url", HTTP_URL),
        read_one_of(reader, forge.get("kind", GITEA), "forge.kind", (GITEA, GITHUB, GITLAB)),
        reader.word(forge.get("api"), "forge.api", HTTP_URL, default=""),
    )
