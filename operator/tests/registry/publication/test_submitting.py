"""Submitting with everything in memory: what is sent, what is followed, what comes back."""

from collections.abc import Callable
from pathlib import Path

import pytest

from robotkube.errors import DocumentError, InputError, RefusalError, UnavailableError
from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.publication.core.report_results import ReportedResult
from robotkube.registry.publication.loops.submitting import (
    PLANNED,
    PUBLISHED,
    REFUSED,
    RETRY_SECONDS_MAX,
    UNAVAILABLE_SECONDS_MAX,
    UNCHANGED,
    SubmissionOutcome,
    Submitting,
)
from robotkube.registry.publication.ports import ChartSource, SubmittedSources
from robotkube.registry.suites.core.requests import SuiteProgress
from tests.stages.registry.publication_in_memory import PublicationStage
from tests.stages.registry.submissions import IMAGE, SUITES, application, chart, entry_path

APPLICATION = {"applications/relaying.yaml": application()}


class Publisher:
    """Submits where the gate does a round whenever the publisher sleeps."""

    def __init__(self, stage: PublicationStage, watching: bool = False) -> None:
        self.stage = stage
        self.now = 0.0
        self.results: list[ReportedResult] = []
        self.lines: list[str] = []
        self.slept: list[float] = []
        self.share = 1.0  # of a bound that is slept after a failure
        self.while_waiting: Callable[[], None] = lambda: None
        forge = stage.forge
        self._submitting = Submitting(
            stage.catalogue,
            forge,
            forge,
            stage.registry,
            "publisher",
            lambda: self.now,
            self.sleep,
            self.lines.append,
            jitter=lambda: self.share,
            report_result=self.results.append if watching else None,
        )

    def sleep(self, seconds: float) -> None:
        self.now += seconds
        self.slept.append(seconds)
        self.while_waiting()
        if not self.stage.catalogue.away:
            self.stage.gate.round()

    def submit(self, sources: SubmittedSources, wait_seconds: float = 60.0, **how: bool) -> SubmissionOutcome:
        return self._submitting.submit(sources, wait_seconds, **how)


@pytest.fixture
def publisher(tmp_path: Path) -> Publisher:
    return Publisher(PublicationStage(tmp_path))


def source(name: str = "relay", version: str = "0.1.0", text: str = "kind: ConfigMap\n") -> ChartSource:
    packed, spec = chart(name, version, text)
    document = {
        "apiVersion": "registry.robotkube.io/v1alpha1",
        "kind": "ChartVersion",
        "metadata": {"name": name},
        "spec": spec,
    }
    return ChartSource(document, packed, (IMAGE,))


def test_everything_given_is_one_pull_request(publisher: Publisher) -> None:
    outcome = publisher.submit(SubmittedSources((source(), source("other")), APPLICATION))
    assert outcome.verdict == PUBLISHED
    assert len(publisher.stage.forge.pulls) == 1
    assert len(outcome.evidence) == 2 * (len(SUITES) + 1)
    title = publisher.stage.forge.pulls[1].title
    assert title.startswith("submit: relay 0.1.0, other 0.1.0, application relaying (")
    assert "relay 0.1.0: pushed to staging-publisher as sha256:" in publisher.lines[0]
    assert "Verified: other 0.1.0, relay 0.1.0, application relaying" in publisher.lines


def test_what_is_published_is_said_so_and_not_submitted_again(publisher: Publisher) -> None:
    first = publisher.submit(SubmittedSources((source(),), APPLICATION))
    again = publisher.submit(SubmittedSources((source(),), APPLICATION))
    assert (again.verdict, again.unchanged, again.evidence) == (UNCHANGED, ("relay 0.1.0",), first.evidence)
    more = publisher.submit(SubmittedSources((source(), source("other"))))
    assert (more.verdict, more.unchanged, [one.name for one in more.charts]) == (
        PUBLISHED,
        ("relay 0.1.0",),
        ["other 0.1.0"],
    )
    assert publisher.stage.runner.runs.count(("relay", "static")) == 1


def test_a_refusal_brings_the_report(publisher: Publisher) -> None:
    publisher.stage.runner.checks["static"] = (Check("probes", False, "none", "add them"),)
    outcome = publisher.submit(SubmittedSources((source(),)))
    assert outcome.verdict == REFUSED
    assert "static of relay failed" in outcome.text
    assert outcome.evidence == {}


def test_a_dry_run_only_says_what_it_would_do(publisher: Publisher) -> None:
    outcome = publisher.submit(SubmittedSources((source(),), APPLICATION), dry_run=True)
    assert (outcome.verdict, outcome.applications) == (PLANNED, ("applications/relaying.yaml",))
    assert publisher.stage.forge.pulls == {}
    assert publisher.stage.registry.charts == {}


def test_what_is_not_decided_in_time_is_followed_by_the_next_call(publisher: Publisher) -> None:
    publisher.stage.runner.progress["install"] = SuiteProgress("running")
    with pytest.raises(UnavailableError, match=r"http://forge/pulls/1: not decided within the given time"):
        publisher.submit(SubmittedSources((source(),)), wait_seconds=5)
    del publisher.stage.runner.progress["install"]
    outcome = publisher.submit(SubmittedSources((source(),)))
    assert (outcome.verdict, outcome.number) == (PUBLISHED, 1)


def test_what_it_waits_for_is_said_once(publisher: Publisher) -> None:
    application_file = {"applications/relaying.yaml": application(initialFor="cloud")}
    with pytest.raises(UnavailableError, match="not decided within the given time"):
        publisher.submit(SubmittedSources((source(),), application_file), wait_seconds=20)
    [waiting] = [line for line in publisher.lines if "It waits: " in line]
    assert "applications/relaying.yaml runs by itself on every agent of role cloud (initialFor)" in waiting
    assert "Somebody with write rights who is no publisher reviews this pull request and approves it" in waiting


def test_only_kept_evidence_of_these_digests_is_carried(publisher: Publisher, tmp_path: Path) -> None:
    kept = publisher.submit(SubmittedSources((source(), source("other")))).evidence
    fresh = Publisher(PublicationStage(tmp_path / "fresh"))
    fresh.stage.signer, fresh.stage.verifier = publisher.stage.signer, publisher.stage.verifier
    fresh.stage.start()
    outcome = fresh.submit(SubmittedSources((source(), source("other", text="kind: Secret\n")), kept=kept))
    assert outcome.verdict == PUBLISHED
    assert fresh.stage.runner.runs == [("other", suite) for suite in SUITES]
    head = fresh.stage.catalogue.commits[fresh.stage.catalogue.heads[1]]
    carried = {path for path in head.changes if path.startswith("evidence/")}
    assert carried == {path for path in kept if path.startswith("evidence/relay/")}


def test_a_pull_request_closed_by_somebody_is_a_refusal(publisher: Publisher) -> None:
    publisher.stage.runner.fail = UnavailableError("away")

    def close() -> None:
        publisher.stage.forge.close(1)

    publisher.while_waiting = close
    publisher.stage.gate.round = lambda: None  # type: ignore[method-assign]
    outcome = publisher.submit(SubmittedSources((source(),)))
    assert outcome.verdict == REFUSED
    assert outcome.text == "the pull request was closed without a report of the gate\n"


def test_the_same_thing_published_by_somebody_else_meanwhile_is_fine(publisher: Publisher) -> None:
    stage = publisher.stage
    other = stage.submit(chart())

    def both() -> None:
        stage.gate.round()

    publisher.while_waiting = both
    outcome = publisher.submit(SubmittedSources((source(),)))
    assert outcome.verdict == PUBLISHED
    assert stage.merged(other)
    assert not stage.merged(2)


def test_a_forge_that_is_away_for_a_moment_is_waited_for(publisher: Publisher) -> None:
    publisher.stage.catalogue.away = True

    def back() -> None:
        publisher.stage.catalogue.away = publisher.now < UNAVAILABLE_SECONDS_MAX / 2

    publisher.while_waiting = back
    assert publisher.submit(SubmittedSources((source(),))).verdict == PUBLISHED
    publisher.stage.catalogue.away = True
    publisher.while_waiting = lambda: None
    with pytest.raises(UnavailableError):
        publisher.submit(SubmittedSources((source("third"),)))


def test_a_forge_that_is_away_is_asked_again_after_growing_pauses_with_jitter(publisher: Publisher) -> None:
    for share in (1.0, 0.5):
        publisher.share = share
        publisher.slept.clear()
        publisher.stage.catalogue.away = True
        with pytest.raises(UnavailableError):
            publisher.submit(SubmittedSources((source(),)))
        assert publisher.slept[:6] == [0.5 * share, share, 2 * share, 4 * share, 5 * share, 5 * share]
        assert UNAVAILABLE_SECONDS_MAX <= sum(publisher.slept) < UNAVAILABLE_SECONDS_MAX + RETRY_SECONDS_MAX


@pytest.mark.parametrize("taken", ["before the answer is lost", "never", "while it is pushed again"])
def test_a_push_without_an_answer_is_made_once(
    publisher: Publisher, taken: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The forge may have taken it before the connection was given up, may not have, or takes it only then."""
    forge = publisher.stage.forge
    propose = forge.propose
    pushes = []

    def slow(commit: str, topic: str, title: str, body: str) -> int | None:
        pushes.append(topic)
        if len(pushes) == 1:
            if taken == "before the answer is lost":
                propose(commit, topic, title, body)
            raise UnavailableError("push: could not read from socket: timed out")
        number = propose(commit, topic, title, body)
        if taken == "while it is pushed again":
            raise RefusalError("ProposalRefused", "new commit is same with old commit")
        return number

    round_of_the_gate = publisher.stage.gate.round
    monkeypatch.setattr(forge, "propose", slow)
    monkeypatch.setattr(publisher.stage.gate, "round", lambda: len(publisher.slept) > 1 and round_of_the_gate())
    assert publisher.submit(SubmittedSources((source(),))).verdict == PUBLISHED
    assert len(pushes) == (1 if taken == "before the answer is lost" else 2)
    assert len({*pushes}) == 1


def test_a_push_that_is_refused_is_not_made_again(publisher: Publisher, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: str) -> int | None:
        raise RefusalError("ProposalRefused", "no")

    monkeypatch.setattr(publisher.stage.forge, "propose", refused)
    with pytest.raises(RefusalError, match="no"):
        publisher.submit(SubmittedSources((source(),)))
    assert publisher.slept == []


def test_a_chart_given_twice_is_refused(publisher: Publisher) -> None:
    with pytest.raises(InputError, match="given twice"):
        publisher.submit(SubmittedSources((source(), source(text="kind: Secret\n"))))


def test_an_entry_that_the_gate_would_not_take_is_refused_before_anything_is_pushed(publisher: Publisher) -> None:
    packed, spec = chart(platforms=["linux/amd64", "linux/arm64"])
    wrong = ChartSource({**source().document, "spec": spec}, packed, (IMAGE,))
    with pytest.raises(DocumentError, match=f"{entry_path(packed)}: spec.platforms: name exactly one"):
        publisher.submit(SubmittedSources((wrong,)))
    assert publisher.stage.registry.charts == {}


def test_what_is_published_can_be_submitted_again(publisher: Publisher) -> None:
    """The gate finds that everything still counts and changes nothing; after a change of keys it would verify again."""
    publisher.submit(SubmittedSources((source(),)))
    outcome = publisher.submit(SubmittedSources((source(),)), again=True)
    assert outcome.verdict == PUBLISHED
    assert "## Already published: relay 0.1.0" in outcome.text
    assert len(publisher.stage.runner.runs) == len(SUITES)


def test_an_entry_that_somebody_merged_by_hand_is_reported(publisher: Publisher) -> None:
    one = source()
    publisher.stage.catalogue.push({one.submitted.path: one.entry})
    with pytest.raises(InputError, match="main has this as staged already, by somebody else"):
        publisher.submit(SubmittedSources((one,)))


def test_results_come_one_by_one_with_their_times_while_others_still_run(tmp_path: Path) -> None:
    publisher = Publisher(PublicationStage(tmp_path), watching=True)
    publisher.stage.runner.progress["install"] = SuiteProgress("running")
    with pytest.raises(UnavailableError, match="not decided within the given time"):
        publisher.submit(SubmittedSources((source(),)), wait_seconds=5)
    first = [(one.chart, one.suite, one.result) for one in publisher.results]
    assert first == [("relay 0.1.0", f"{suite} 1", "passed") for suite in SUITES if suite != "install"]
    assert all(one.ended.endswith("Z") and one.seconds is not None for one in publisher.results)
    assert not any("passed" in line and "suites" not in line for line in publisher.lines)
    del publisher.stage.runner.progress["install"]
    publisher.stage.runner.checks["install"] = (Check("becomes-ready", False, "no", "do"), Check("x", False, "n", "d"))
    publisher.results.clear()
    assert publisher.submit(SubmittedSources((source(),))).verdict == REFUSED
    (last,) = [one for one in publisher.results if one.suite.startswith("install")]
    assert (last.result, last.checks) == ("failed", ("becomes-ready", "x"))
    assert len(publisher.results) == len(SUITES)
