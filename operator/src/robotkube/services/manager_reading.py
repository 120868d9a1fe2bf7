"""What the manager has read of main: its files as values, people's policy; and the catalogue as a page.

The last good version stays while a newer one is broken: a broken file must never look like a withdrawal.
"""

from __future__ import annotations

import logging
from typing import Any

from robotkube.domain.catalogue import Catalogue
from robotkube.domain.catalogue_documents import entry_documents
from robotkube.domain.errors import InputError
from robotkube.domain.initial import PATH as INITIAL_PATH
from robotkube.domain.initial import InitialPolicy, read_initial_policy
from robotkube.domain.releases import RELEASES, SOURCES, Tree, read_tree
from robotkube.ports.git import DeploymentRepository

POLICIES = "policies"

log = logging.getLogger(__name__)


def catalogue_page(catalogue: Catalogue, tip: str) -> dict[str, Any]:
    """The document of GET /catalogue."""
    return {"commit": tip, "assurance": catalogue.assurance, "entries": entry_documents(catalogue)}


class MainReader:
    """Main of the deployment repository: its releases and sources, and policies/initial.yaml."""

    def __init__(self, repository: DeploymentRepository) -> None:
        self._repository = repository
        self.tip = ""
        self.tree = Tree({}, {})
        self.policy = InitialPolicy()
        self.policy_text = ""
        self._policy_good = False

    def read(self, known: str = "") -> bool:
        """Take the newest commit (`known` when its id is known and it is here, else fetched); whether main has moved.
        InputError as long as main or its policy cannot be read at all."""
        if known:
            self._repository.moved_to(known)
        newest = known or self._repository.fetch()
        if not newest:
            raise InputError("the deployment repository has no main branch yet; nothing is planned")
        if newest == self.tip:
            return False
        files = self._repository.files(newest, (RELEASES, SOURCES, POLICIES))
        self._read_policy(files.get(INITIAL_PATH, "{}\n"), newest)
        self.tree = read_tree({path: text for path, text in files.items() if not path.startswith(f"{POLICIES}/")})
        self.tip = newest
        for problem in self.tree.problems:
            log.error("main has a broken file commit=%s problem=%r", newest[:12], problem)
        return True

    def _read_policy(self, text: str, commit: str) -> None:
        try:
            self.policy, self.policy_text, self._policy_good = read_initial_policy(text), text, True
        except InputError as error:
            if not self._policy_good:
                raise
            log.error("policy not taken commit=%s problem=%r", commit[:12], str(error))
