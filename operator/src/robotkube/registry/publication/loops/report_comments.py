"""The gate's one comment in the pull request of a submission: written once, edited when its text changes."""

from __future__ import annotations

from collections.abc import Collection

from robotkube.foundation.forge.ports.pull_requests import Forge
from robotkube.registry.publication.core.report import MARKER, Report, report_text
from robotkube.registry.publication.loops.submission_reader import PublicationSettings, SubmissionInProgress


class ReportComments:
    """The comments of one gate; what was written is remembered, and read again after a start."""

    def __init__(self, forge: Forge, settings: PublicationSettings) -> None:
        self._forge = forge
        self._settings = settings
        self._known: dict[int, tuple[int, str]] = {}

    def keep(self, numbers: Collection[int]) -> None:
        """Forget all pull requests but these."""
        self._known = {number: known for number, known in self._known.items() if number in numbers}

    def report(self, underway: SubmissionInProgress, verdict: str) -> None:
        """Write the report into the pull request: one comment, edited when its text changes."""
        content = Report(
            verdict,
            underway.submission.names,
            underway.commit.id,
            charts_url=self._settings.charts_url,
            policy=underway.policy.digest if underway.policy else "",
            charts=tuple(chart.report() for chart in underway.charts),
            problems=tuple(underway.problems),
            waiting_for=underway.waiting_for,
            applications=tuple(underway.submission.applications),
            notes=tuple(underway.applications.notes),
        )
        self._write(underway.number, report_text(content))

    def _write(self, number: int, text: str) -> None:
        identifier, written = self._known.get(number) or self._own_comment(number)
        if written == text:
            return
        if identifier:
            self._forge.edit_comment(identifier, text)
        else:
            self._forge.comment(number, text)
            identifier, _ = self._own_comment(number)
        self._known[number] = (identifier, text)

    def _own_comment(self, number: int) -> tuple[int, str]:
        for comment in self._forge.comments(number):
            if comment.author == self._settings.account and comment.text.startswith(MARKER):
                return comment.id, comment.text
        return 0, ""
