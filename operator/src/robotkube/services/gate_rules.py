"""What the gate checks by: its own settings, the catalogue assessed with its own keys, and policies read from main.

Nothing here comes from the branch that is judged.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from robotkube.domain import checks
from robotkube.domain.checks_releases import Rules
from robotkube.domain.errors import DocumentError
from robotkube.domain.merging import PATH as MERGE_PATH
from robotkube.domain.merging import MergePolicy, read_merge_policy
from robotkube.domain.releases import Tree, read_tree
from robotkube.domain.repairs import repair
from robotkube.domain.values_schemas import Validate
from robotkube.ports.git import Commit, MainBranch
from robotkube.services.assured_catalogue import AssuredCatalogue
from robotkube.services.main_history import Terms, older_files, release_files

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class GateSettings:
    """`account`: the gate's own; `deployment`, `catalogue`: `<organisation>/<name>` of the repositories; `proposers`:
    whose proposals of releases are taken, and where; `charts_url`: oci://host/organisation."""

    account: str
    deployment: str
    catalogue: str
    proposers: tuple[checks.Proposer, ...]
    charts_url: str

    def proposer(self, account: str) -> checks.Proposer | None:
        """The proposer of that name; None when it is none."""
        return next((found for found in self.proposers if found.account == account), None)

    @property
    def accounts(self) -> Sequence[str]:
        """Names of the proposers."""
        return [proposer.account for proposer in self.proposers]


@dataclass(frozen=True)
class _Main:
    """releases/ and sources/ at one tip, as text and read, and what would bring them back (see repairs.repair)."""

    tip: str
    files: Mapping[str, str]
    tree: Tree
    repair: Mapping[str, str | None]


class RuleBook:
    """Rules for whoever proposes, while main stands where `main` has it."""

    def __init__(
        self, settings: GateSettings, main: MainBranch, catalogue: AssuredCatalogue, validate: Validate
    ) -> None:
        self._settings, self._main, self._catalogue, self._validate = settings, main, catalogue, validate
        self._terms = Terms(main, settings.accounts)
        self._main_now = _Main("", {}, Tree({}, {}), {})

    def refresh(self) -> bool:
        """Read the catalogue and the keys again; whether anything changed."""
        before = self._catalogue.catalogue
        self._catalogue.read()
        return self._catalogue.catalogue is not before

    def _rules(self, account: str, namespaces: frozenset[str], others: frozenset[str]) -> Rules:
        if not self._catalogue.tip:
            self._catalogue.read()
        return Rules(
            account=account,
            namespaces=namespaces,
            charts_url=self._settings.charts_url,
            catalogue=self._catalogue.catalogue,
            schema=self._catalogue.schema,
            validate=self._validate,
            others=others,
            last_term=self._terms.last(account, self._main.tip),
            repair=self._known().repair,
        )

    def _known(self) -> _Main:
        """Main's files as they are, read once per tip; its history is looked at only when something is broken."""
        if self._main_now.tip != self._main.tip:
            files = release_files(self._main, self._main.tip)
            tree = read_tree(files)
            changes = repair(files, older_files(self._main)) if tree.problems else {}
            self._main_now = _Main(self._main.tip, files, tree, changes)
        return self._main_now

    def proposal(self, commit: Commit) -> checks.Proposal:
        """What a commit brings to main."""
        main = self._known()
        after = checks.folders_of(checks.apply_changes(main.files, commit.changes))
        return checks.Proposal(
            commit.parents, commit.message, commit.changes, commit.irregular, main.tree, read_tree(after)
        )

    def judge(self, account: str, proposal: checks.Proposal) -> checks.Verdict:
        """What the rules for `account` say about a proposal."""
        everywhere = {name for proposer in self._settings.proposers for name in proposer.namespaces}
        proposer = self._settings.proposer(account)
        if proposer is None:
            rules = self._rules(account, frozenset(everywhere), frozenset())
            return checks.judge_person(proposal, self._main.tip, rules)
        rules = self._rules(account, proposer.namespaces, frozenset(everywhere) - proposer.namespaces)
        return checks.judge(proposal, self._main.tip, rules)

    def merge_policy(self) -> MergePolicy:
        """policies/merge.yaml on main; nothing merges by itself while it is missing or cannot be read."""
        text = self._main.files(self._main.tip, (MERGE_PATH.split("/", 1)[0],)).get(MERGE_PATH)
        if text is None:
            log.error("merge policy missing commit=%s path=%s", self._main.tip[:12], MERGE_PATH)
            return MergePolicy({}, ())
        try:
            return _read_policy(text)
        except DocumentError as error:
            log.error("merge policy unusable commit=%s problem=%r", self._main.tip[:12], str(error))
            return MergePolicy({}, ())


@lru_cache(16)
def _read_policy(text: str) -> MergePolicy:
    return read_merge_policy(text)
