"""The gate's rules: its own settings, the catalogue assessed with its own keys, and policies read from main.

Nothing here comes from the branch that is judged.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

from robotkube.delivery.deployment.core.borders import Borders, scopes_of
from robotkube.delivery.deployment.core.policies.agents import PATH as AGENTS_PATH
from robotkube.delivery.deployment.core.policies.agents import read_enrolled
from robotkube.delivery.deployment.core.policies.links import LinkConsents, read_consents
from robotkube.delivery.deployment.core.policies.merge import PATH as MERGE_PATH
from robotkube.delivery.deployment.core.policies.merge import MergePolicy, Way, read_merge_policy
from robotkube.delivery.deployment.core.releases import Release, Tree, read_tree
from robotkube.delivery.deployment.core.repairs import repair
from robotkube.delivery.deployment.loops.main_history import Terms, older_files, policy_files, release_files
from robotkube.delivery.gate.core import proposal_checks
from robotkube.delivery.gate.core.check_results import no_clock
from robotkube.delivery.gate.core.release_checks import Rules
from robotkube.errors import DocumentError
from robotkube.foundation.forge.ports.repositories import Commit, MainBranch
from robotkube.registry.catalogue.loops.verified_catalogue import AssuredCatalogue
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.charts.core.values_schemas import Validate
from robotkube.registry.charts.ports import RenderedImages

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class GateSettings:
    """The gate's settings. `account`: its own; `deployment`, `catalogue`: `<organisation>/<name>` of the repositories;
    `proposers`: who may propose releases, and where; `charts_url`: oci://host/organisation; `reserved`: agents that
    main may enroll."""

    account: str
    deployment: str
    catalogue: str
    proposers: tuple[proposal_checks.Proposer, ...]
    charts_url: str
    reserved: frozenset[str] = frozenset()

    def proposer(self, account: str) -> proposal_checks.Proposer | None:
        """The proposer with that account; None when there is none."""
        return next((proposer for proposer in self.proposers if proposer.account == account), None)

    @property
    def accounts(self) -> Sequence[str]:
        """Names of the proposers."""
        return [proposer.account for proposer in self.proposers]


@dataclass(frozen=True)
class _Main:
    """releases/ and sources/ at one tip, as text and read, and what would bring them back (see repairs.repair);
    `consents`: what scopes let pass their borders; `enrolled`: who is enrolled."""

    tip: str
    files: Mapping[str, str]
    tree: Tree
    repair: Mapping[str, str | None]
    consents: LinkConsents = field(default_factory=LinkConsents)
    enrolled: frozenset[str] = frozenset()


class GateRules:
    """The rules for each account, while main stands where `main` has it; `clock` counts seconds, of each check."""

    def __init__(
        self,
        settings: GateSettings,
        main: MainBranch,
        catalogue: AssuredCatalogue,
        validate: Validate,
        images: RenderedImages,
        clock: Callable[[], float] = no_clock,
    ) -> None:
        self._clock = clock
        self._settings = settings
        self._main = main
        self._catalogue = catalogue
        self._validate = validate
        self._images = images
        self._terms = Terms(main, settings.accounts)
        self._main_now = _Main("", {}, Tree({}, {}), {})

    @property
    def catalogue_tip(self) -> str:
        """The commit of the catalogue that is decided by."""
        return self._catalogue.tip

    def refresh(self) -> bool:
        """Read the catalogue and the keys again; return whether anything changed."""
        before = self._catalogue.catalogue
        self._catalogue.read()
        return self._catalogue.catalogue is not before

    def _rules(self, account: str, namespaces: frozenset[str], others: frozenset[str]) -> Rules:
        if not self._catalogue.tip:
            self._catalogue.read()
        known = self._known()
        return Rules(
            account=account,
            namespaces=namespaces,
            charts_url=self._settings.charts_url,
            catalogue=self._catalogue.catalogue,
            schema=self._catalogue.schema,
            validate=self._validate,
            images=self._images_of,
            others=others,
            last_term=self._terms.last(account, self._main.tip),
            repair=known.repair,
            accounts=tuple(self._settings.accounts),
            borders=Borders(scopes_of((p.account, p.namespaces) for p in self._settings.proposers), known.consents),
            reserved=self._settings.reserved,
            enrolled=known.enrolled,
        )

    def _images_of(self, release: Release) -> Sequence[str]:
        chart = ChartReference(release.chart, release.version, release.digest)
        return self._images(chart, release.values, release.plan, release.name, release.namespace)

    def _known(self) -> _Main:
        """Main's files as they are, read once per tip; its history is read only when something is broken. A policy that
        cannot be read is what it was before."""
        if self._main_now.tip != self._main.tip:
            files = release_files(self._main, self._main.tip)
            tree = read_tree(files)
            changes = repair(files, older_files(self._main)) if tree.problems else {}
            policies = policy_files(self._main, self._main.tip)
            consents, problems = read_consents(policies, self._main_now.consents)
            for problem in problems:
                log.error("policy unusable commit=%s problem=%r", self._main.tip[:12], problem)
            self._main_now = _Main(self._main.tip, files, tree, changes, consents, self._enrolled(policies))
        return self._main_now

    def _enrolled(self, policies: Mapping[str, str]) -> frozenset[str]:
        try:
            return frozenset(read_enrolled(policies.get(AGENTS_PATH)))
        except DocumentError as error:
            log.error("policy unusable commit=%s problem=%r", self._main.tip[:12], str(error))
            return self._main_now.enrolled

    def proposal(self, commit: Commit, overlaps: Sequence[str] = ()) -> proposal_checks.ProposedCommit:
        """The proposed commit, with main's files before and after it; `overlaps`: what main has changed, too."""
        main = self._known()
        after = proposal_checks.folders_of(proposal_checks.apply_changes(main.files, commit.changes))
        return proposal_checks.ProposedCommit(
            *(commit.parents, commit.message, commit.changes, commit.irregular, main.tree, read_tree(after)),
            tuple(overlaps),
        )

    def judge(self, account: str, proposal: proposal_checks.ProposedCommit) -> proposal_checks.ProposalVerdict:
        """The verdict of the rules for `account` about a proposal."""
        everywhere = {name for proposer in self._settings.proposers for name in proposer.namespaces}
        proposer = self._settings.proposer(account)
        if proposer is None:
            rules = self._rules(account, frozenset(everywhere), frozenset())
            return proposal_checks.judge_person(proposal, rules, self._clock)
        rules = self._rules(account, proposer.namespaces, frozenset(everywhere) - proposer.namespaces)
        return proposal_checks.judge(proposal, self._main.tip, rules, self._clock)

    def way(self, author: str, paths: Sequence[str]) -> Way:
        """The way in which main's policy lets a pull request be merged; an account that is no manager is a person's."""
        policy = self._merge_policy()
        if self._settings.proposer(author) is None:
            return policy.way_of_person(paths)
        return policy.way_of_plan(author, paths)

    def _merge_policy(self) -> MergePolicy:
        """The merge policy on main; while it is missing or cannot be read, only its repair is open to approval."""
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
