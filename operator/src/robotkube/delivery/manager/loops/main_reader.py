"""Main as the manager has read it: its files as values, people's policies and edits; and the catalogue as a page.

The last good version stays while a newer one is broken: a broken file must never look like a withdrawal.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from robotkube.delivery.deployment.core.policies.agents import PATH as AGENTS_PATH
from robotkube.delivery.deployment.core.policies.agents import read_enrolled
from robotkube.delivery.deployment.core.policies.edits import PATH as EDITS_PATH
from robotkube.delivery.deployment.core.policies.edits import RESPECT, REVERT, EditsPolicy, read_edits_policy
from robotkube.delivery.deployment.core.policies.initial import PATH as INITIAL_PATH
from robotkube.delivery.deployment.core.policies.initial import InitialPolicy, read_initial_policy
from robotkube.delivery.deployment.core.policies.links import LinkConsents, read_consents
from robotkube.delivery.deployment.core.releases import RELEASES, Tree, read_tree
from robotkube.delivery.deployment.core.repairs import repair
from robotkube.delivery.deployment.loops.main_history import older_files, policy_files, release_files, term_of
from robotkube.delivery.manager.core.plans import Change
from robotkube.delivery.manager.core.respected_edits import respected
from robotkube.errors import InputError
from robotkube.foundation.forge.ports.repositories import Commit, DeploymentRepository, NoteTexts
from robotkube.registry.catalogue.core.catalogue import Catalogue
from robotkube.registry.catalogue.core.entry_documents import entry_documents

COMMITS_READ_MAX = 200

log = logging.getLogger(__name__)


def catalogue_page(catalogue: Catalogue, tip: str) -> dict[str, Any]:
    """The document of GET /catalogue."""
    return {"commit": tip, "assurance": catalogue.assurance, "entries": entry_documents(catalogue)}


class MainReader:
    """Main of the deployment repository: its releases and sources, policies/initial.yaml, policies/edits.yaml, what
    policies/links/ lets pass between scopes, and whom policies/agents.yaml enrolls.

    `edits` are the releases whose file a person was the last to change: path -> the person's commit. `new_commits` are
    those that the last reading brought, oldest first, at most COMMITS_READ_MAX; `notes` those of its commits with the
    outcomes of plans (None: nobody reads them)."""

    def __init__(self, repository: DeploymentRepository, notes: NoteTexts | None = None) -> None:
        self._repository = repository
        self.notes = notes
        self.tip = ""
        self.tree = Tree({}, {})
        self.policy = InitialPolicy()
        self.policy_text = ""
        self.edits_policy: EditsPolicy = REVERT
        self.consents = LinkConsents()
        self.enrolled: Mapping[str, str] = {}
        self.edits: dict[str, str] = {}
        self._editors: dict[str, str] = {}
        self.new_commits: Sequence[Commit] = ()
        self._files: Mapping[str, str] = {}
        self._wanted_first: dict[str, str] = {}
        self._policy_good = False
        self._enrollment_good = False

    @property
    def repository(self) -> DeploymentRepository:
        """The repository that main is read from."""
        return self._repository

    def read(self, known: str = "") -> bool:
        """Read the newest commit (`known` when its id is known and it is here, else fetched); return whether main has
        moved. InputError as long as main or its policy cannot be read at all."""
        if known:
            self._repository.moved_to(known)
        newest = known or self._repository.fetch()
        if not newest:
            raise InputError("the deployment repository has no main branch yet; nothing is planned")
        if newest == self.tip:
            return False
        policies = policy_files(self._repository, newest)
        self._read_policy(policies.get(INITIAL_PATH, "{}\n"), newest)
        self._read_edits_policy(policies.get(EDITS_PATH, ""), newest)
        self._read_consents(policies, newest)
        self._read_enrolled(policies.get(AGENTS_PATH), newest)
        self._files = release_files(self._repository, newest)
        self.tree = read_tree(self._files)
        self.new_commits = self._repository.log(self.tip or None, COMMITS_READ_MAX)
        self._note_edits(self.new_commits)
        self.tip = newest
        for problem in self.tree.problems:
            log.error("main has a broken file commit=%s problem=%r", newest[:12], problem)
        return True

    def repair(self) -> dict[str, str | None]:
        """The repair of a broken main: path -> text, None removes; empty when nothing is broken."""
        return repair(self._files, older_files(self._repository)) if self.tree.problems else {}

    def reverted(self, paths: Iterable[str]) -> tuple[str, ...]:
        """The commits of people that a plan which writes `paths` undoes."""
        return tuple(sorted({self.edits[path] for path in paths if path in self.edits}))

    def standing_edits(self) -> Mapping[str, str]:
        """The edits of people that are respected: path -> commit and author, in words; none under another policy."""
        if self.edits_policy != RESPECT:
            return {}
        return {path: f"commit {commit[:12]} of {self._editors[commit]}" for path, commit in self.edits.items()}

    def respected(self, changes: Sequence[Change], remember: bool = True) -> tuple[Change, ...]:
        """The changes that may be made although people edited main. What was wanted when an edit was first seen is
        remembered, except for a question that has no effect (`remember` false)."""
        first = self._wanted_first if remember else dict(self._wanted_first)
        if self.edits_policy == RESPECT:
            return respected(changes, self.edits, first)
        first.clear()
        return tuple(changes)

    def _note_edits(self, commits: Iterable[Commit]) -> None:
        for commit in commits:
            by_a_plan = term_of(commit.message) is not None
            for path in (*commit.changes, *commit.irregular):
                if not path.startswith(f"{RELEASES}/") or path.endswith("/.gitkeep"):
                    continue
                if by_a_plan:
                    self.edits.pop(path, None)
                else:
                    self.edits[path] = commit.id
                    self._editors[commit.id] = commit.author
        self._editors = {commit: self._editors[commit] for commit in self.edits.values()}

    def _read_policy(self, text: str, commit: str) -> None:
        try:
            self.policy = read_initial_policy(text)
            self.policy_text = text
            self._policy_good = True
        except InputError as error:
            if not self._policy_good:
                raise
            log.error("policy not accepted commit=%s problem=%r", commit[:12], str(error))

    def _read_edits_policy(self, text: str, commit: str) -> None:
        try:
            self.edits_policy = read_edits_policy(text) if text else REVERT
        except InputError as error:
            log.error("policy not accepted commit=%s problem=%r", commit[:12], str(error))

    def _read_enrolled(self, text: str | None, commit: str) -> None:
        try:
            enrolled = read_enrolled(text)
        except InputError as error:
            if not self._enrollment_good:
                raise
            log.error("policy not accepted commit=%s problem=%r", commit[:12], str(error))
            return
        self._enrollment_good = True
        if enrolled != self.enrolled:
            self.enrolled = enrolled

    def _read_consents(self, policies: Mapping[str, str], commit: str) -> None:
        self.consents, problems = read_consents(policies, self.consents)
        for problem in problems:
            log.error("policy not accepted commit=%s problem=%r", commit[:12], problem)
