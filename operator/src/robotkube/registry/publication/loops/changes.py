"""People's changes of the catalogue: policies, applications, withdrawals. The gate checks them and merges them when
another person approved exactly the commit that it checked; nobody else moves main. With an application it merges its
own statement about it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence

from robotkube.errors import DocumentError, RobotKubeError
from robotkube.foundation.forge.core import merge_comments
from robotkube.foundation.forge.core.resync import RESYNC_SECONDS
from robotkube.foundation.forge.core.reviews import approvers
from robotkube.foundation.forge.loops.merging import merge_commit
from robotkube.foundation.forge.ports.pull_requests import Forge, PullRequest
from robotkube.foundation.forge.ports.repositories import Commit, Commits, MainBranch
from robotkube.registry.catalogue.core.sources import Tools
from robotkube.registry.publication.core.changes import change_problems
from robotkube.registry.publication.core.submissions import APPLICATIONS, EVIDENCE, READ_FOLDERS
from robotkube.registry.publication.loops.application_verification import ApplicationVerification, TriedApplications
from robotkube.registry.publication.loops.submission_reader import PublicationSettings

WHO = "another person with write rights, who is no publisher"
WAITS = f"The gate merges what exactly this commit changes when {WHO}, approves it."

log = logging.getLogger(__name__)


class ChangesOfPeople:
    """The pull requests of all who are no publishers, at one catalogue repository; for one thread. `commits` makes
    commits in the clone of `main`; `applications` tries what they change; `merged` is called after every push to
    main."""

    def __init__(
        self,
        forge: Forge,
        main: MainBranch,
        commits: Commits,
        applications: ApplicationVerification,
        settings: PublicationSettings,
        tools: Tools,
        monotonic: Callable[[], float],
        merged: Callable[[], None],
    ) -> None:
        self._forge = forge
        self._main = main
        self._commits = commits
        self._applications = applications
        self._settings = settings
        self._tools = tools
        self._monotonic = monotonic
        self._merged = merged
        self._listed_at = monotonic() - RESYNC_SECONDS
        self._judged: dict[int, tuple[str, str, Sequence[str]]] = {}
        self._first_lines: dict[int, set[str]] = {}

    def round(self, woken: bool = False) -> None:
        """Judge and merge what can be, oldest first; at most every RESYNC_SECONDS unless somebody `woken` it."""
        if not woken and self._monotonic() - self._listed_at < RESYNC_SECONDS:
            return
        self._listed_at = self._monotonic()
        machines = (*self._settings.publishers, self._settings.account)
        pulls = {pull.number: pull for pull in self._forge.pull_requests("open") if pull.author not in machines}
        self._judged = {number: known for number, known in self._judged.items() if number in pulls}
        self._first_lines = {number: lines for number, lines in self._first_lines.items() if number in pulls}
        for number in sorted(pulls):
            try:
                self._advance(pulls[number])
            except Exception as error:  # whatever a change does to its checks, the others and submissions go on
                expected = isinstance(error, RobotKubeError)
                text = error if expected else f"{type(error).__name__}: {error}"
                log.error("change failed number=%d reason=%s", number, text, exc_info=not expected)

    def _advance(self, pull: PullRequest) -> None:
        """Say once what is to be said about this head, main's tip and the approvals; merge it when it may be."""
        approved_by = self._approved_by(pull, pull.head)
        if self._judged.get(pull.number) == (pull.head, self._main.tip, approved_by):
            return
        try:
            commit = self._main.proposal(pull.number)
            if commit.id != pull.head or self._main.contains(commit.id):
                return  # another head is for the next round; what is on main the forge shows as merged before long
            settled = self._decide(pull, self._main.changes_since_branch(commit.id), approved_by)
        except DocumentError as error:
            self._say(pull.number, merge_comments.refused_text(pull.head, error.problems))
            settled = True
        if settled:
            self._judged[pull.number] = (pull.head, self._main.tip, approved_by)

    def _decide(self, pull: PullRequest, change: Commit, approved_by: Sequence[str]) -> bool:
        """Return whether there is nothing left to do before head, tip or approvals change."""
        tried, problems = self._judge(change.changes, change.irregular)
        overlaps = self._main.overlaps(change)
        if problems:
            self._say(pull.number, merge_comments.refused_text(change.id, problems))
        elif overlaps:
            self._say(pull.number, merge_comments.outdated_text(change.id, overlaps))
        elif not approved_by:
            self._say(pull.number, merge_comments.accepted_text(change.id, WAITS))
        else:
            return self._merge(pull, change, approved_by, self._applications.statements(tried))
        return True

    def _merge(
        self, pull: PullRequest, change: Commit, approved_by: Sequence[str], statements: Mapping[str, str]
    ) -> bool:
        """Push the merge, with the statements about its applications, after it was checked as it would stand on main;
        False when main has moved meanwhile."""
        merge = merge_commit(self._main, self._commits, pull, change, approved_by, statements)
        added = statements.items()
        theirs = {path: text for path, text in merge.changes.items() if (path, text) not in added}
        _, problems = self._judge(theirs, merge.irregular)
        if problems:
            self._say(pull.number, merge_comments.refused_text(change.id, problems))
            return True
        if not self._main.push_main(merge.id):
            self._main.fetch()
            return False
        log.info(
            "change merged number=%d author=%s commit=%s approved_by=%s paths=%d",
            *(pull.number, pull.author, merge.id[:12], ",".join(approved_by), len(change.changes)),
        )
        self._merged()
        return True

    def _judge(
        self, changes: Mapping[str, str | None], irregular: Sequence[str]
    ) -> tuple[TriedApplications, Sequence[str]]:
        """What speaks against changes to main: what is wrong with the files, then with the applications among them."""
        files = self._main.files(self._main.tip, READ_FOLDERS)
        problems = change_problems(changes, irregular, files, self._tools)
        if problems or not any(path.startswith(f"{APPLICATIONS}/") for path in changes):
            return TriedApplications(), problems
        main = {**files, **self._main.files(self._main.tip, (EVIDENCE,))}
        after = {path: text for path, text in {**main, **changes}.items() if text is not None}
        tried = self._applications.tried(main, after)
        return tried, tried.problems

    def _approved_by(self, pull: PullRequest, commit: str) -> Sequence[str]:
        machines = (*self._settings.publishers, self._settings.account)
        return approvers(self._forge.reviews(pull.number), commit, pull.author, machines)

    def _say(self, number: int, text: str) -> None:
        """Comment unless a comment with the same first line is there, also from before a restart."""
        first = text.partition("\n")[0]
        if number not in self._first_lines:
            own = [one.text for one in self._forge.comments(number) if one.author == self._settings.account]
            self._first_lines[number] = {comment.partition("\n")[0] for comment in own}
        if first not in self._first_lines[number]:
            self._forge.comment(number, text)
            self._first_lines[number].add(first)
