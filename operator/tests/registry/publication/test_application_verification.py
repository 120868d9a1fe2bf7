"""Applications at publication: tried with the submission, signed with it, and not signed when they came another way."""

from __future__ import annotations

from pathlib import Path

import pytest

from robotkube.errors import UnavailableError
from robotkube.foundation.forge.core.resync import RESYNC_SECONDS
from robotkube.foundation.forge.core.reviews import Review
from robotkube.registry.catalogue.core.applications import Application
from robotkube.registry.catalogue.loops.verified_catalogue import EvidenceReader
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.evidence.core.application_statements import document_digest
from tests.stages.registry.publication_in_memory import PublicationStage
from tests.stages.registry.submissions import application, chart

PATH, STATEMENT = "applications/relaying.yaml", "evidence/applications/relaying.json"
OTHER, OTHER_STATEMENT = "applications/other.yaml", "evidence/applications/other.json"
RELEASE = "policies/release.yaml"
STRICT = {RELEASE: "assurance: verified\napplications: verified\n"}


@pytest.fixture
def stage(tmp_path: Path) -> PublicationStage:
    return PublicationStage(tmp_path)


def on_main(stage: PublicationStage, name: str = "relaying") -> Application:
    """The application as managers see it."""
    return EvidenceReader(stage.verifier).read(stage.main()).applications[name]


def published(stage: PublicationStage, **more: str) -> None:
    """The chart and the application, published together."""
    number = stage.submit(chart(), **{PATH: application(), **more})
    stage.settle(number)
    assert stage.merged(number)


def test_what_a_submission_brings_is_signed_in_the_same_commit(stage: PublicationStage) -> None:
    number = stage.submit(chart(), **{PATH: application()})
    text = stage.settle(number)
    newest = stage.catalogue.commits[stage.catalogue.tip]
    assert {PATH, STATEMENT} <= set(newest.changes)
    main = on_main(stage)
    assert main.assured
    assert main.digest == document_digest(application())
    assert "- application relaying: composed for 1 samples of its parameters, 1 releases" in text
    packed = chart()[0]
    assert (frozenset({"relaying"}), frozenset({ChartReference("relay", "0.1.0", packed.digest)})) in stage.trials.asked


def test_the_same_again_is_published_already(stage: PublicationStage) -> None:
    published(stage)
    tip = stage.catalogue.tip
    assert "## Already published" in stage.settle(stage.submit(chart(), **{PATH: application()}))
    assert stage.catalogue.tip == tip


def test_what_a_trial_finds_refuses_before_any_suite_runs(stage: PublicationStage) -> None:
    stage.trials.problems["relaying"] = ("spec.services[0]: a pod would run image x (with parameters {'a': 1})",)
    number = stage.submit(chart(), **{PATH: application()})
    text = stage.settle(number)
    assert not stage.merged(number)
    assert "## Refused" in text
    assert (
        r"- applications/relaying.yaml: spec.services\[0\]: a pod would run image x (with parameters {'a': 1})" in text
    )
    assert stage.runner.runs == []
    assert PATH not in stage.main()
    assert STATEMENT not in stage.main()


def test_while_nothing_can_be_rendered_it_waits(stage: PublicationStage) -> None:
    stage.trials.fail = UnavailableError("charts cannot be rendered: it is not there")
    number = stage.submit(chart(), **{PATH: application()})
    stage.gate.round()
    assert "It waits: charts cannot be rendered: it is not there" in stage.text(number)
    assert PATH not in stage.main()
    stage.trials.fail = None
    stage.settle(number)
    assert on_main(stage).assured


def test_a_changed_application_is_tried_and_signed_anew(stage: PublicationStage) -> None:
    published(stage)
    changed = application(description="Relays, and more")
    stage.settle(stage.submit(**{PATH: changed}))
    assert on_main(stage).assured
    assert on_main(stage).digest == document_digest(changed)


def test_a_chart_version_that_breaks_what_is_published_is_refused(stage: PublicationStage) -> None:
    published(stage)
    stage.trials.problems["relaying"] = ("spec: chart relay 0.2.0: values.rate: it is wrong",)
    stage.trials.only_with["relaying"] = "charts/relay/0.2.0.yaml"
    number = stage.submit(chart(version="0.2.0", replaces="0.1.0"))
    text = stage.settle(number)
    assert not stage.merged(number)
    assert "applications/relaying.yaml, which is published, would not work any more: spec: chart relay 0.2.0" in text


def test_what_did_not_pass_before_does_not_hold_up_a_chart_and_is_not_signed(stage: PublicationStage) -> None:
    stage.settle(stage.submit(chart()))
    stage.catalogue.push({PATH: application()})
    stage.trials.problems["relaying"] = ("spec: it never worked",)
    number = stage.submit(chart(version="0.2.0", replaces="0.1.0"))
    stage.settle(number)
    assert stage.merged(number)
    assert STATEMENT not in stage.main()


def test_a_trial_that_was_not_finished_says_nothing_of_what_is_published(stage: PublicationStage) -> None:
    published(stage)
    signed = stage.main()[STATEMENT]
    stage.trials.problems["relaying"] = ("spec: to try it needs more than 60 s",)
    stage.trials.only_with["relaying"] = "charts/relay/0.2.0.yaml"
    stage.trials.unfinished.add("relaying")
    number = stage.submit(chart(version="0.2.0", replaces="0.1.0"))
    stage.settle(number)
    assert stage.merged(number)
    assert stage.main()[STATEMENT] == signed


def test_what_was_edited_past_the_gate_is_not_signed_by_a_later_publication(stage: PublicationStage) -> None:
    published(stage)
    signed = stage.main()[STATEMENT]
    edited = application(description="Edited where nobody looked")
    stage.catalogue.push({PATH: edited})
    stage.settle(stage.submit(chart(version="0.2.0", replaces="0.1.0")))
    assert stage.main()[STATEMENT] == signed
    assert not on_main(stage).assured
    assert "is not what was verified" in on_main(stage).evidence_problem
    stage.catalogue.push({STATEMENT: "{}"})
    stage.settle(stage.submit(chart("another")))
    assert stage.main()[STATEMENT] == "{}"


def test_a_statement_of_another_application_is_not_renewed(stage: PublicationStage) -> None:
    published(stage)
    stage.catalogue.push({OTHER: application("other"), OTHER_STATEMENT: stage.main()[STATEMENT]})
    stage.settle(stage.submit(chart(version="0.2.0", replaces="0.1.0")))
    assert not on_main(stage, "other").assured
    assert on_main(stage, "other").evidence_problem == "the evidence is about application 'relaying', not 'other'"


def test_what_an_older_gate_published_is_signed_by_the_next_publication_unless_the_policy_is_strict(
    stage: PublicationStage,
) -> None:
    stage.settle(stage.submit(chart()))
    stage.catalogue.push({PATH: application(), **STRICT})
    stage.settle(stage.submit(chart("another")))
    assert STATEMENT not in stage.main()
    stage.catalogue.push({RELEASE: "assurance: verified\n"})
    stage.settle(stage.submit(**{OTHER: application("other")}))
    assert on_main(stage).assured
    assert on_main(stage, "other").assured


def test_a_chart_submitted_again_brings_the_statements_that_are_missing(stage: PublicationStage) -> None:
    stage.settle(stage.submit(chart()))
    stage.catalogue.push({PATH: application()})
    number = stage.submit(chart())
    assert "## Verified" in stage.settle(number)
    assert on_main(stage).assured
    assert set(stage.catalogue.commits[stage.catalogue.tip].changes) == {STATEMENT}


def test_a_new_policy_lets_what_was_signed_be_signed_again_with_its_charts(stage: PublicationStage) -> None:
    published(stage)
    policy = "policies/verification.yaml"
    stage.catalogue.push({**STRICT, policy: stage.main()[policy].replace("seconds: 60", "seconds: 61")})
    assert "made under another policy" in on_main(stage).evidence_problem
    number = stage.submit(chart())
    stage.settle(number)
    assert stage.merged(number)
    assert on_main(stage).assured


def test_another_version_of_the_bridge_is_tried_with_everything_that_links(stage: PublicationStage) -> None:
    bridge = application("bridging", "relay", provides=["link/mqtt"])
    topic = {"name": "/a", "type": "std_msgs/msg/String", "channel": "telemetry", "reliability": "reliable"}
    link = {"kind": "mqtt", "from": {"role": "vehicle"}, "to": {"role": "cloud"}}
    topics = [{**topic, "durability": "volatile", "depth": 1}]
    linking = application("linking", services=[], links=[{**link, "topics": topics}])
    more = {"applications/bridging.yaml": bridge, "applications/linking.yaml": linking}
    number = stage.submit(chart(), **more)
    assert "Verified" in stage.settle(number)
    stage.settle(stage.submit(chart(version="0.2.0", replaces="0.1.0")))
    assert stage.trials.asked[-1][0] == {"bridging", "linking"}


@pytest.mark.parametrize("path", [STATEMENT, "evidence/applications/x/relaying.json"])
def test_a_publisher_brings_no_statement(stage: PublicationStage, path: str) -> None:
    text = stage.settle(stage.submit(chart(), **{PATH: application(), path: "{}"}))
    assert "a publisher may only touch" in text
    assert PATH not in stage.main()


# -- people ----------------------------------------------------------------------------------------------------------


def proposed(stage: PublicationStage, changes: dict[str, str | None]) -> tuple[int, str]:
    """A person's pull request that another one approved, and what the gate says to it."""
    number = stage.forge.open(stage.catalogue.commit(stage.catalogue.tip, changes, "By hand"), "operator-team")
    head = stage.forge.pulls[number].head
    stage.forge.reviewed[number] = [Review("reviewer", head, True, True)]
    for _ in range(2):
        stage.now += RESYNC_SECONDS
        stage.gate.round()
    stage.forge.pull_requests("all")
    return number, "\n".join(comment.text for comment in stage.forge.said[number])


def test_a_persons_application_is_tried_and_signed_in_the_merge(stage: PublicationStage) -> None:
    published(stage)
    changed = application(description="Changed by hand")
    number, _ = proposed(stage, {PATH: changed})
    assert stage.merged(number)
    assert on_main(stage).assured
    newest = stage.catalogue.commits[stage.catalogue.tip]
    assert set(newest.changes) == {PATH, STATEMENT}
    assert newest.parents[1] == stage.forge.pulls[number].head


def test_a_persons_application_that_does_not_pass_cannot_be_merged(stage: PublicationStage) -> None:
    published(stage)
    stage.trials.problems["relaying"] = ("spec.services[0]: Deployment relay: volume x: type hostPath",)
    number, text = proposed(stage, {PATH: application(description="Changed by hand")})
    assert not stage.merged(number)
    assert "it cannot be merged." in text
    assert "applications/relaying.yaml: spec.services[0]: Deployment relay: volume x: type hostPath" in text
    assert on_main(stage).assured


def test_nobody_writes_a_statement_by_hand_and_who_takes_it_away_takes_its_evidence(stage: PublicationStage) -> None:
    published(stage)
    number, text = proposed(stage, {PATH: application(description="Changed"), STATEMENT: stage.main()[STATEMENT] + " "})
    assert not stage.merged(number)
    assert f"{STATEMENT}: the gate alone writes this file" in text
    number, _ = proposed(stage, {STATEMENT: None})
    assert stage.merged(number)
    assert on_main(stage).evidence == ""


def test_a_withdrawal_tries_nothing(stage: PublicationStage) -> None:
    published(stage)
    asked = len(stage.trials.asked)
    path = "charts/relay/0.1.0.yaml"
    number, _ = proposed(stage, {path: stage.main()[path].replace("state: verified", "state: withdrawn")})
    assert stage.merged(number)
    assert len(stage.trials.asked) == asked
    assert on_main(stage).assured
