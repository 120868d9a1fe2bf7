"""The gate: checks what the manager proposes, moves main to exactly the checked commit, and tells Argo CD.

Level-triggered: a round looks at the open proposals and at main's tip, decides and acts; a webhook only brings the next
round forward. So lost webhooks, restarts and half-finished rounds are repaired by the next round. A proposal whose
commit is in main already is left to the forge, which marks it merged by itself.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from robotkube.domain import checks
from robotkube.domain.catalogue import FOLDERS as CATALOGUE_FOLDERS
from robotkube.domain.catalogue import Catalogue, read_catalogue
from robotkube.domain.errors import RobotKubeError
from robotkube.domain.releases import RELEASES, SOURCES, read_tree
from robotkube.ports.forges import Forge, PullRequest, PushHook
from robotkube.ports.git import Commit, MainBranch, RepositoryFiles

POLL_SECONDS = 2.0  # open proposals, when no webhook came
LOOK_SECONDS = 10.0  # main's tip and the catalogue, when no webhook came
SILENT_SECONDS_MAX = 30.0  # not ready when the forge was not seen for longer
VERDICTS = ("accepted", "refused", "stale", "failed")
HOOKS = ("taken", "lost")
WAKING_ACTIONS = frozenset({"opened", "reopened", "synchronized"})

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class GateSettings:
    """`deployment`, `catalogue`: `<organisation>/<name>` of the repositories; `proposer`: the only account whose
    proposals are taken; `namespaces`: of the declared agents; `charts_url`: oci://host/organisation."""

    deployment: str
    catalogue: str
    proposer: str
    namespaces: frozenset[str]
    charts_url: str


@dataclass
class GateStatistics:
    """Counted since the start; `decision_seconds` is the sum over all decided proposals, from the round's look at it to
    the moment main moved or the refusal stood."""

    verdicts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(VERDICTS, 0))
    hooks: dict[str, int] = field(default_factory=lambda: dict.fromkeys(HOOKS, 0))
    decision_seconds: float = 0.0
    rounds: int = 0


class Gate:
    """One gate for one deployment repository; `run` on one thread, `wake` from any.

    `monotonic` is a clock in seconds that never goes back.
    """

    def __init__(
        self,
        forge: Forge,
        main: MainBranch,
        catalogue: RepositoryFiles,
        push_hook: PushHook,
        settings: GateSettings,
        monotonic: Callable[[], float],
    ) -> None:
        self._forge, self._main, self._catalogue_files, self._push_hook = forge, main, catalogue, push_hook
        self._settings, self._monotonic = settings, monotonic
        self.statistics = GateStatistics()
        self._catalogue: tuple[str, Catalogue] = ("", Catalogue())
        self._announced = ""
        self._settled: dict[int, str] = {}
        self._told: dict[int, str] = {}
        self._woken = threading.Event()
        self._look_due = True
        self._seen_at = monotonic() - SILENT_SECONDS_MAX - 1

    # -- waking ---------------------------------------------------------------------------------------------------

    def wake(self, event: str, payload: Mapping[str, Any]) -> None:
        """A signed delivery of the forge; only decides whether the next round comes now."""
        repository = (payload.get("repository") or {}).get("full_name")
        moved_main = event == "push" and payload.get("after") not in (self._main.tip, self._announced)
        proposed = event.startswith("pull_request") and payload.get("action") in WAKING_ACTIONS
        if repository == self._settings.catalogue or moved_main:
            self._look_due = True
            self._woken.set()
        elif proposed:
            self._woken.set()

    def stop(self, stopping: threading.Event) -> None:
        """End `run` after the round that is under way."""
        stopping.set()
        self._woken.set()

    def reasons_not_ready(self) -> list[str]:
        """Empty when the forge was seen lately."""
        silent = self._monotonic() - self._seen_at
        return [f"the forge was not seen for {silent:.0f} s"] if silent > SILENT_SECONDS_MAX else []

    def run(self, stopping: threading.Event) -> None:
        """Rounds until `stopping` is set; errors of the world are logged and met again in the next round."""
        looked_at = self._monotonic() - LOOK_SECONDS
        while not stopping.is_set():
            self._woken.clear()
            look = self._look_due or self._monotonic() - looked_at >= LOOK_SECONDS
            if look:
                self._look_due, looked_at = False, self._monotonic()
            try:
                self.round(look)
            except RobotKubeError as error:
                log.error("round failed reason=%s", error)
            self._woken.wait(POLL_SECONDS)

    # -- one round ------------------------------------------------------------------------------------------------

    def round(self, look_at_main: bool = True) -> None:
        """Decide all open proposals, oldest first; then, when asked, see whether main moved; announce it if so."""
        self.statistics.rounds += 1
        proposals = self._forge.pull_requests("open", self._settings.proposer)
        self._seen_at = self._monotonic()
        open_numbers = {proposal.number for proposal in proposals}
        for known in (self._settled, self._told):
            for number in known.keys() - open_numbers:
                del known[number]
        for proposal in sorted(proposals, key=lambda found: found.number):
            if proposal.author == self._settings.proposer and self._settled.get(proposal.number) != proposal.head:
                self._try_to_decide(proposal)
        if look_at_main:
            self._main.fetch()
            self._read_catalogue(fresh=True)
        if self._main.tip != self._announced:
            self._announce(self._announced, self._main.tip)

    def _try_to_decide(self, pull_request: PullRequest) -> None:
        try:
            self._decide(pull_request)
        except RobotKubeError as error:
            self.statistics.verdicts["failed"] += 1
            log.error("proposal failed number=%d reason=%s", pull_request.number, error)

    def _decide(self, pull_request: PullRequest) -> None:
        started = self._monotonic()
        commit = self._main.proposal(pull_request.number)
        if self._main.contains(commit.id):
            self._settled[pull_request.number] = commit.id
            return
        fetched = self._monotonic()
        verdict = self._judge(commit)
        judged = self._monotonic()
        before = self._main.tip
        if verdict.accepted and not self._main.push_main(commit.id):
            self._main.fetch()
            verdict = checks.Verdict(stale=True)
        if not verdict.accepted:
            self._turn_down(pull_request.number, commit, verdict)
        decided = self._monotonic()
        self._settled[pull_request.number] = commit.id
        if verdict.accepted:
            self._announce(before, commit.id)
        self._record(pull_request.number, commit, verdict, (started, fetched, judged, decided, self._monotonic()))

    def _judge(self, commit: Commit) -> checks.Verdict:
        verdict = self._judge_with(commit, self._read_catalogue(fresh=False))
        if verdict.problems:  # the catalogue may have moved without its webhook reaching this gate
            known = self._catalogue[0]
            self._read_catalogue(fresh=True)
            if self._catalogue[0] != known:
                return self._judge_with(commit, self._catalogue[1])
        return verdict

    def _judge_with(self, commit: Commit, catalogue: Catalogue) -> checks.Verdict:
        files = self._main.files(self._main.tip, (RELEASES, SOURCES))
        after = checks.folders_of(checks.apply_changes(files, commit.changes))
        proposal = checks.Proposal(
            commit.parents, commit.message, commit.changes, commit.irregular, read_tree(files), read_tree(after)
        )
        rules = checks.Rules(self._settings.namespaces, self._settings.charts_url, catalogue)
        return checks.judge(proposal, self._main.tip, rules)

    def _read_catalogue(self, fresh: bool) -> Catalogue:
        known, catalogue = self._catalogue
        if fresh or not known:
            tip = self._catalogue_files.fetch()
            if tip != known:
                catalogue = read_catalogue(self._catalogue_files.files(tip, CATALOGUE_FOLDERS))
                self._catalogue = (tip, catalogue)
                for problem in catalogue.problems:
                    log.warning("catalogue entry unusable commit=%s problem=%s", tip[:12], problem)
        return catalogue

    def _turn_down(self, number: int, commit: Commit, verdict: checks.Verdict) -> None:
        if verdict.stale:
            text = checks.stale_text(commit.parents[0] if commit.parents else "", self._main.tip)
        else:
            text = checks.refusal_text(verdict.problems)
        if self._told.get(number) != commit.id:  # said once, also when closing has to be tried again
            self._forge.comment(number, text)
            self._told[number] = commit.id
        self._forge.close(number)

    def _announce(self, before: str, after: str) -> None:
        """Tell Argo CD; what was not taken is told again in the next round."""
        if self._push_hook.hook(before or after, after):
            self._announced = after
            self.statistics.hooks["taken"] += 1
            log.info("announced before=%s after=%s", before[:12], after[:12])
        else:
            self.statistics.hooks["lost"] += 1

    def _record(self, number: int, commit: Commit, verdict: checks.Verdict, at: tuple[float, ...]) -> None:
        started, fetched, judged, decided, announced = at
        name = "accepted" if verdict.accepted else "stale" if verdict.stale else "refused"
        self.statistics.verdicts[name] += 1
        self.statistics.decision_seconds += decided - started
        log.info(
            "proposal number=%d commit=%s verdict=%s problems=%d "
            "fetch_ms=%.0f check_ms=%.0f decide_ms=%.0f hook_ms=%.0f subject=%r",
            *(number, commit.id[:12], name, len(verdict.problems)),
            *(1000 * (fetched - started), 1000 * (judged - fetched), 1000 * (decided - judged)),
            1000 * (announced - decided),
            commit.message.partition("\n")[0],
        )  # fmt: skip


def metrics_text(statistics: GateStatistics) -> str:
    """The statistics as Prometheus text."""
    lines = [
        "# TYPE robotkube_gate_proposals_total counter",
        *(f'robotkube_gate_proposals_total{{verdict="{k}"}} {v}' for k, v in statistics.verdicts.items()),
        "# TYPE robotkube_gate_hooks_total counter",
        *(f'robotkube_gate_hooks_total{{result="{k}"}} {v}' for k, v in statistics.hooks.items()),
        "# TYPE robotkube_gate_decision_seconds_total counter",
        f"robotkube_gate_decision_seconds_total {statistics.decision_seconds:.6f}",
        "# TYPE robotkube_gate_rounds_total counter",
        f"robotkube_gate_rounds_total {statistics.rounds}",
    ]
    return "\n".join(lines) + "\n"
