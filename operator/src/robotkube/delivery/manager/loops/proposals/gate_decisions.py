"""The gate's decisions about proposals, read from Git and the forge; and for task statuses, why one still waits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from robotkube.delivery.deployment.core.verdict_words import FIRST_WORDS, STALE, WAITS
from robotkube.delivery.manager.core.plans import Plan
from robotkube.delivery.manager.loops.proposals.plan_records import PlanRecord
from robotkube.delivery.tasks.core.task_description import GATE_UNAVAILABLE, WAITS_FOR_APPROVAL
from robotkube.foundation.forge.ports.pull_requests import Forge, PullRequest
from robotkube.foundation.forge.ports.repositories import DeploymentRepository

VERDICT_SECONDS_MAX = 15.0  # without a verdict for longer, the gate is reported as unavailable
COMMENTS_SECONDS = 10.0  # how often the comments of a proposal that waits longer are read

ProposalOutcome = Literal["merged", "outdated", "refused", "waiting"]


@dataclass
class PendingProposal:
    """A plan that waits for the gate; `since` and `comments_read_at` in monotonic seconds; `asked`: what of its tasks
    it answers (see open_proposals.asked_for)."""

    plan: Plan
    record: PlanRecord
    since: float
    comments_read_at: float = float("-inf")
    asked: Mapping[str, str] = field(default_factory=dict)


class GateDecisions:
    """A reader of the gate's decisions; `monotonic` is a clock in seconds that never goes back."""

    def __init__(self, deployment: DeploymentRepository, forge: Forge, monotonic: Callable[[], float]) -> None:
        self._deployment = deployment
        self._forge = forge
        self._monotonic = monotonic

    def poll(self, proposal: PendingProposal, tip: str) -> tuple[ProposalOutcome, str]:
        """The outcome while main stands at `tip`, and the gate's words when it refused. A proposal that waits for
        longer than VERDICT_SECONDS_MAX gets into its record what it waits for."""
        record = proposal.record
        if self._deployment.contains(record.commit):
            return "merged", ""
        if tip != proposal.plan.base:
            return "outdated", ""
        pull = self.pull_request(record)
        if pull is not None and pull.state == "closed" and not pull.merged:
            text = self._last_comment(pull.number) or "closed without a comment"
            return ("outdated", "") if STALE in text.partition("\n")[0] else ("refused", text)
        if self._monotonic() - proposal.since > VERDICT_SECONDS_MAX:
            self._record_wait(proposal)
        return "waiting", ""

    def pull_request(self, record: PlanRecord) -> PullRequest | None:
        """The pull request of a record, which gets its number and address."""
        if record.pull_request is not None:
            pull: PullRequest | None = self._forge.pull_request(record.pull_request)
        else:
            pull = next((p for p in self._forge.pull_requests("all") if p.head == record.commit), None)
        self.name(record, pull)
        return pull

    @staticmethod
    def name(record: PlanRecord, pull: PullRequest | None) -> None:
        """Give a record the number and address of its pull request."""
        if pull is not None:
            record.pull_request = pull.number
            record.url = pull.url

    def _last_comment(self, number: int) -> str:
        """The gate's last comment, else anybody's."""
        texts = [comment.text.strip() for comment in self._forge.comments(number)]
        return next((text for text in reversed(texts) if text.startswith(FIRST_WORDS)), texts[-1] if texts else "")

    def _record_wait(self, proposal: PendingProposal) -> None:
        number = proposal.record.pull_request
        if number is None or self._monotonic() - proposal.comments_read_at < COMMENTS_SECONDS:
            return
        proposal.comments_read_at = self._monotonic()
        text = self._last_comment(number)
        if text.startswith(WAITS):
            proposal.record.waits = (WAITS_FOR_APPROVAL, f"pull request {number}: {text}")
        else:
            text = f"no verdict of the gate about pull request {number} within {VERDICT_SECONDS_MAX:.0f} s"
            proposal.record.waits = (GATE_UNAVAILABLE, f"{text}; it waits, and goes on when the gate answers")
