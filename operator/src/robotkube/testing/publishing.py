"""What publication needs, in memory: a catalogue repository that publishers propose to, an OCI registry of charts, and
a suite-runner and trials of applications whose results a test decides. A test can make each of them fail at its next
calls."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.documents.core.digests import canonical_json, sha256
from robotkube.foundation.forge.ports.pull_requests import PullRequest
from robotkube.foundation.forge.ports.repositories import Commit
from robotkube.registry.charts.core.packing import PackedChart, PulledChart
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.charts.core.unpacking import unpack_chart
from robotkube.registry.charts.ports import Attachment
from robotkube.registry.evidence.core.application_statements import TrialResult
from robotkube.registry.evidence.core.statements import Check, SuiteResult
from robotkube.registry.evidence.core.verification_policy import PATH as POLICY_PATH
from robotkube.registry.suites.core.requests import SuiteProgress, SuiteRequest
from robotkube.testing.forges import MemoryForge, MemoryRepository

PUBLISHER = "publisher"


class MemoryCatalogue(MemoryRepository):
    """The catalogue repository with its pull requests' heads, as the gate sees it."""

    def __init__(self, files: Mapping[str, str]) -> None:
        super().__init__()
        self.heads: dict[int, str] = {}
        self.before_push: Callable[[], None] = lambda: None
        self.push(dict(files), "seed")

    def proposal(self, number: int) -> Commit:
        """The head of a pull request."""
        self.fetch()
        return self.commits[self.heads[number]]

    def contains(self, commit: str) -> bool:
        """Return whether `commit` is main's tip or an ancestor, by any parent."""
        ancestors: set[str] = set()
        left = [self.tip]
        while left:
            at = left.pop()
            if at and at not in ancestors:
                ancestors.add(at)
                left += self.commits[at].parents
        return commit in ancestors

    def changes_since_branch(self, commit: str) -> Commit:
        """`commit` with what it changes since its first ancestor that is on main."""
        base = commit
        while not self.contains(base):
            base = self.commits[base].parents[0]
        before, after = self.trees[base], self.trees[commit]
        changed = sorted(path for path in {*before, *after} if before.get(path) != after.get(path))
        return replace(self.commits[commit], parents=(base,), changes={path: after.get(path) for path in changed})

    def overlaps(self, change: Commit) -> Sequence[str]:
        """Paths that both the commit and main changed, differently."""
        base, tip = self.trees[change.parents[0]], self.trees[self.tip]
        return [path for path, text in change.changes.items() if tip.get(path) not in (base.get(path), text)]

    def push_main(self, commit: str) -> bool:
        """Move main to a commit, fast-forward only."""
        self._reach()
        self.before_push()
        if self.commits[commit].parents[0] != self.tip:
            return False
        self.tip = commit
        return True


class MemoryCatalogueForge(MemoryForge):
    """Pull requests of the catalogue: nobody decides but the gate under test; what main contains shows as merged."""

    def __init__(self, repository: MemoryCatalogue) -> None:
        super().__init__(repository)
        self.catalogue = repository
        self.decide = self.leave

    def propose(self, commit: str, topic: str, title: str, body: str) -> int | None:
        """Open a pull request by an AGit push of the publisher."""
        number = super().propose(commit, topic, title, body)
        assert number is not None
        self.pulls[number] = replace(self.pulls[number], author=PUBLISHER)
        self.catalogue.heads[number] = commit
        return number

    def open(self, commit: str, author: str = PUBLISHER) -> int:
        """Open a pull request by an AGit push of `author`."""
        number = self.propose(commit, f"submit-{len(self.pulls)}", "submission", "")
        assert number is not None
        self.pulls[number] = replace(self.pulls[number], author=author)
        return number

    def update(self, number: int, commit: str) -> None:
        """Push another commit to the same pull request."""
        self.pulls[number] = replace(self.pulls[number], head=commit)
        self.catalogue.heads[number] = commit

    def pull_request(self, number: int) -> PullRequest:
        """One pull request, as the forge shows it once it has seen main."""
        self.pull_requests("all")
        return super().pull_request(number)

    def pull_requests(self, state: str = "open", author: str = "") -> Sequence[PullRequest]:
        """The pull requests, as the forge shows them once it has seen main."""
        for number, pull in self.pulls.items():
            if pull.state == "open" and self.catalogue.contains(pull.head):
                merged = replace(pull, state="closed", merged=True, merge_commit=self.catalogue.tip)
                self.pulls[number] = merged
        return super().pull_requests(state, author)


@dataclass
class MemoryChartRegistry:
    """Charts, tags and attachments by repository; `before` is called with the name of every method that writes."""

    charts: dict[str, dict[str, PackedChart]] = field(default_factory=dict)
    tags: dict[str, dict[str, str]] = field(default_factory=dict)
    attached: dict[tuple[str, str], list[Attachment]] = field(default_factory=dict)
    before: Callable[[str], None] = lambda method: None
    images: dict[str, set[str]] = field(default_factory=dict)

    def push_chart(self, organisation: str, chart: PackedChart, tag: str = "") -> str:
        """Push a chart as a publisher does."""
        repository = f"{organisation}/{chart.name}"
        self._tag(repository, tag or chart.tag, chart.digest)
        self.charts.setdefault(repository, {})[chart.digest] = chart
        return chart.digest

    def manifest_digest(self, repository: str, reference: str) -> str | None:
        """The manifest's digest by tag or digest; None when it is not there."""
        digest = self.tags.get(repository, {}).get(reference, reference)
        present = digest in self.charts.get(repository, {}) or digest in self.images.get(repository, ())
        return digest if present else None

    def pull_chart(self, repository: str, digest: str) -> PulledChart:
        """The unpacked chart of a digest."""
        if digest not in self.charts.get(repository, {}):
            raise InputError(f"{repository}: no {digest}")
        chart = self.charts[repository][digest]
        return unpack_chart(repository, chart.manifest, chart.config, chart.archive)

    def attach(
        self, repository: str, subject: str, artifact_type: str, data: bytes, annotations: Mapping[str, str]
    ) -> str:
        """Attach an artifact, once for the same arguments; its digest."""
        self.before("attach")
        digest = sha256(canonical_json([subject, artifact_type, sha256(data), dict(annotations)]))
        attachments = self.attached.setdefault((repository, subject), [])
        if all(attachment.digest != digest for attachment in attachments):
            attachments.append(Attachment(digest, artifact_type, data, dict(annotations)))
        return digest

    def attachments(self, repository: str, subject: str) -> Sequence[Attachment]:
        """The attachments of a subject, oldest first."""
        return tuple(self.attached.get((repository, subject), ()))

    def copy_chart(self, source: str, target: str, digest: str, tag: str, attachments: Collection[str]) -> None:
        """Copy a chart with the named attachments."""
        self.before("copy_chart")
        self._tag(target, tag, digest)
        self.charts.setdefault(target, {})[digest] = self.charts[source][digest]
        known = {attachment.digest: attachment for attachment in self.attachments(source, digest)}
        there = self.attached.setdefault((target, digest), [])
        there += [known[name] for name in attachments if known[name] not in there]

    def copy_image(self, source: str, target: str, digest: str, artifact_type: str) -> None:
        """Copy an image, which is its digest alone, with what of that type is attached to it."""
        self.before("copy_image")
        if digest not in self.images.get(source, ()):
            raise InputError(f"{source} has no manifest {digest}; push it again")
        self.images.setdefault(target, set()).add(digest)
        there = self.attached.setdefault((target, digest), [])
        attached = [
            attachment for attachment in self.attachments(source, digest) if attachment.artifact_type == artifact_type
        ]
        there += [one for one in attached if one not in there]

    def remove_image(self, repository: str, digest: str) -> None:
        """Remove an image and what is attached to it."""
        self.before("remove_image")
        self.images.get(repository, set()).discard(digest)
        self.attached.pop((repository, digest), None)

    def _tag(self, repository: str, tag: str, digest: str) -> None:
        present = self.tags.setdefault(repository, {}).setdefault(tag, digest)
        if present != digest:
            raise InputError(f"{repository}:{tag} is {present}; a tag is never overwritten")


@dataclass
class ScriptedRunner:
    """A suite-runner: every suite passes, but for those in `checks` (suite -> checks) and in `progress` (suite -> what
    is answered until a test removes it). `requests` holds all requests, `runs` the keys that ran."""

    checks: dict[str, tuple[Check, ...]] = field(default_factory=dict)
    progress: dict[str, SuiteProgress] = field(default_factory=dict)
    requests: list[SuiteRequest] = field(default_factory=list)
    runs: list[tuple[str, str]] = field(default_factory=list)
    fail: Exception | None = None
    results: dict[str, tuple[str, SuiteResult]] = field(default_factory=dict)

    def run(self, request: SuiteRequest) -> SuiteProgress:
        """The scripted answer."""
        if self.fail is not None:
            raise self.fail
        self.requests.append(request)
        name = request.rule.name
        if name in self.progress:
            return self.progress[name]
        attempt, known = self.results.get(request.key, ("", None))
        if known is None or (known.outcome != "passed" and attempt != request.attempt):
            known = self._result(request)
            self.runs.append((request.artefact.chart, name))
            self.results[request.key] = (request.attempt, known)
        return SuiteProgress("finished", known)

    def _result(self, request: SuiteRequest) -> SuiteResult:
        name = request.rule.name
        checks = self.checks.get(name, (Check(f"{name} looked at it", True),))
        outcome: Any = "passed" if all(check.passed for check in checks) else "failed"
        return SuiteResult(name, request.rule.version, outcome, checks, 1.5)


@dataclass
class ScriptedTrials:
    """Trials of applications: every one passes, but for those in `problems` (application -> sentences) as long as the
    catalogue has the file in `only_with` for it; those of `unfinished` met their bounds. `asked` holds the names and
    charts of all calls that tried any."""

    problems: dict[str, tuple[str, ...]] = field(default_factory=dict)
    only_with: dict[str, str] = field(default_factory=dict)
    unfinished: set[str] = field(default_factory=set)
    asked: list[tuple[frozenset[str], frozenset[ChartReference]]] = field(default_factory=list)
    fail: Exception | None = None

    def __call__(
        self, files: Mapping[str, str], names: Collection[str], submitted: Collection[ChartReference] = ()
    ) -> Mapping[str, TrialResult]:
        """The scripted results."""
        if self.fail is not None:
            raise self.fail
        if POLICY_PATH not in files or not names:
            return {}
        self.asked.append((frozenset(names), frozenset(submitted)))
        problems = {name: self._problems(name, files) for name in names}
        return {name: TrialResult(problems[name], (), 1, 1, self._finished(name, problems[name])) for name in names}

    def _finished(self, name: str, problems: tuple[str, ...]) -> bool:
        return not problems or name not in self.unfinished

    def _problems(self, name: str, files: Mapping[str, str]) -> tuple[str, ...]:
        there = self.only_with.get(name)
        return () if there is not None and there not in files else self.problems.get(name, ())
