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
def world(tmp_path: Path) -> PublicationStage:
    return PublicationStage(tmp_path)


def on_main(world: PublicationStage, name: str = "relaying") -> Application:
    """The application as managers see it."""
    return EvidenceReader(world.verifier).read(world.main()).applications[name]


def published(world: PublicationStage, **more: str) -> None:
    """The chart and the application, published together."""
    number = world.submit(chart(), **{PATH: application(), **more})
    world.settle(number)
    assert world.merged(number)


def test_what_a_submission_brings_is_signed_in_the_same_commit(world: PublicationStage) -> None:
    number = world.submit(chart(), **{PATH: application()})
    text = world.settle(number)
    newest = world.catalogue.commits[world.catalogue.tip]
    assert {PATH, STATEMENT} <= set(newest.changes)
    main = on_main(world)
    assert main.assured
    assert main.digest == document_digest(application())
    assert "- application relaying: composed for 1 samples of its parameters, 1 releases" in text
    packed = chart()[0]
    assert (frozenset({"relaying"}), frozenset({ChartReference("relay", "0.1.0", packed.digest)})) in world.trials.asked


def test_the_same_again_is_published_already(world: PublicationStage) -> None:
    published(world)
    tip = world.catalogue.tip
    assert "## Already published" in world.settle(world.submit(chart(), **{PATH: application()}))
    assert world.catalogue.tip == tip


def test_what_a_trial_finds_refuses_before_any_suite_runs(world: PublicationStage) -> None:
    world.trials.problems["relaying"] = ("spec.services[0]: a pod would run image x (with parameters {'a': 1})",)
    number = world.submit(chart(), **{PATH: application()})
    text = world.settle(number)
    assert not world.merged(number)
    assert "## Refused" in text
    assert (
        r"- applications/relaying.yaml: spec.services\[0\]: a pod would run image x (with parameters {'a': 1})" in text
    )
    assert world.runner.runs == []
    assert PATH not in world.main()
    assert STATEMENT not in world.main()


def test_while_nothing_can_be_rendered_it_waits(world: PublicationStage) -> None:
    world.trials.fail = UnavailableError("charts cannot be rendered: it is not there")
    number = world.submit(chart(), **{PATH: application()})
    world.gate.round()
    assert "It waits: charts cannot be rendered: it is not there" in world.text(number)
    assert PATH not in world.main()
    world.trials.fail = None
    world.settle(number)
    assert on_main(world).assured


def test_a_changed_application_is_tried_and_signed_anew(world: PublicationStage) -> None:
    published(world)
    changed = application(description="Relays, and more")
    world.settle(world.submit(**{PATH: changed}))
    assert on_main(world).assured
    assert on_main(world).digest == document_digest(changed)


def test_a_chart_version_that_breaks_what_is_published_is_refused(world: PublicationStage) -> None:
    published(world)
    world.trials.problems["relaying"] = ("spec: chart relay 0.2.0: values.rate: it is wrong",)
    world.trials.only_with["relaying"] = "charts/relay/0.2.0.yaml"
    number = world.submit(chart(version="0.2.0", replaces="0.1.0"))
    text = world.settle(number)
    assert not world.merged(number)
    assert "applications/relaying.yaml, which is published, would not work any more: spec: chart relay 0.2.0" in text


def test_what_did_not_pass_before_does_not_hold_up_a_chart_and_is_not_signed(world: PublicationStage) -> None:
    world.settle(world.submit(chart()))
    world.catalogue.push({PATH: application()})
    world.trials.problems["relaying"] = ("spec: it never worked",)
    number = world.submit(chart(version="0.2.0", replaces="0.1.0"))
    world.settle(number)
    assert world.merged(number)
    assert STATEMENT not in world.main()


def test_a_trial_that_was_not_finished_says_nothing_of_what_is_published(world: PublicationStage) -> None:
    published(world)
    signed = world.main()[STATEMENT]
    world.trials.problems["relaying"] = ("spec: to try it needs more than 60 s",)
    world.trials.only_with["relaying"] = "charts/relay/0.2.0.yaml"
    world.trials.unfinished.add("relaying")
    number = world.submit(chart(version="0.2.0", replaces="0.1.0"))
    world.settle(number)
    assert world.merged(number)
    assert world.main()[STATEMENT] == signed


def test_what_was_edited_past_the_gate_is_not_signed_by_a_later_publication(world: PublicationStage) -> None:
    published(world)
    signed = world.main()[STATEMENT]
    edited = application(description="Edited where nobody looked")
    world.catalogue.push({PATH: edited})
    world.settle(world.submit(chart(version="0.2.0", replaces="0.1.0")))
    assert world.main()[STATEMENT] == signed
    assert not on_main(world).assured
    assert "is not what was verified" in on_main(world).evidence_problem
    world.catalogue.push({STATEMENT: "{}"})
    world.settle(world.submit(chart("another")))
    assert world.main()[STATEMENT] == "{}"


def test_a_statement_of_another_application_is_not_renewed(world: PublicationStage) -> None:
    published(world)
    world.catalogue.push({OTHER: application("other"), OTHER_STATEMENT: world.main()[STATEMENT]})
    world.settle(world.submit(chart(version="0.2.0", replaces="0.1.0")))
    assert not on_main(world, "other").assured
    assert on_main(world, "other").evidence_problem == "the evidence is about application 'relaying', not 'other'"


def test_what_an_older_gate_published_is_signed_by_the_next_publication_unless_the_policy_is_strict(
    world: PublicationStage,
) -> None:
    world.settle(world.submit(chart()))
    world.catalogue.push({PATH: application(), **STRICT})
    world.settle(world.submit(chart("another")))
    assert STATEMENT not in world.main()
    world.catalogue.push({RELEASE: "assurance: verified\n"})
    world.settle(world.submit(**{OTHER: application("other")}))
    assert on_main(world).assured
    assert on_main(world, "other").assured


def test_a_chart_submitted_again_brings_the_statements_that_are_missing(world: PublicationStage) -> None:
    world.settle(world.submit(chart()))
    world.catalogue.push({PATH: application()})
    number = world.submit(chart())
    assert "## Verified" in world.settle(number)
    assert on_main(world).assured
    assert set(world.catalogue.commits[world.catalogue.tip].changes) == {STATEMENT}


def test_a_new_policy_lets_what_was_signed_be_signed_again_with_its_charts(world: PublicationStage) -> None:
    published(world)
    policy = "policies/verification.yaml"
    world.catalogue.push({**STRICT, policy: world.main()[policy].replace("seconds: 60", "seconds: 61")})
    assert "made under another policy" in on_main(world).evidence_problem
    number = world.submit(chart())
    world.settle(number)
    assert world.merged(number)
    assert on_main(world).assured


def test_another_version_of_the_bridge_is_tried_with_everything_that_links(world: PublicationStage) -> None:
    bridge = application("bridging", "relay", provides=["link/mqtt"])
    topic = {"name": "/a", "type": "std_msgs/msg/String", "channel": "telemetry", "reliability": "reliable"}
    link = {"kind": "mqtt", "from": {"role": "vehicle"}, "to": {"role": "cloud"}}
    topics = [{**topic, "durability": "volatile", "depth": 1}]
    linking = application("linking", services=[], links=[{**link, "topics": topics}])
    more = {"applications/bridging.yaml": bridge, "applications/linking.yaml": linking}
    number = world.submit(chart(), **more)
    assert "Verified" in world.settle(number)
    world.settle(world.submit(chart(version="0.2.0", replaces="0.1.0")))
    assert world.trials.asked[-1][0] == {"bridging", "linking"}


@pytest.mark.parametrize("path", [STATEMENT, "evidence/applications/x/relaying.json"])
def test_a_publisher_brings_no_statement(world: PublicationStage, path: str) -> None:
    text = world.settle(world.submit(chart(), **{PATH: application(), path: "{}"}))
    assert "a publisher may only touch" in text
    assert PATH not in world.main()


# -- people ----------------------------------------------------------------------------------------------------------


def proposed(world: PublicationStage, changes: dict[str, str | None]) -> tuple[int, str]:
    """A person's pull request that another one approved, and what the gate says to it."""
    number = world.forge.open(world.catalogue.commit(world.catalogue.tip, changes, "By hand"), "operator-team")
    head = world.forge.pulls[number].head
    world.forge.reviewed[number] = [Review("reviewer", head, True, True)]
    for _ in range(2):
        world.now += RESYNC_SECONDS
        world.gate.round()
    world.forge.pull_requests("all")
    return number, "\n".join(comment.text for comment in world.forge.said[number])


def test_a_persons_application_is_tried_and_signed_in_the_merge(world: PublicationStage) -> None:
    published(world)
    changed = application(description="Changed by hand")
    number, _ = proposed(world, {PATH: changed})
    assert world.merged(number)
    assert on_main(world).assured
    newest = world.catalogue.commits[world.catalogue.tip]
    assert set(newest.changes) == {PATH, STATEMENT}
    assert newest.parents[1] == world.forge.pulls[number].head


def test_a_persons_application_that_does_not_pass_cannot_be_merged(world: PublicationStage) -> None:
    published(world)
    world.trials.problems["relaying"] = ("spec.services[0]: Deployment relay: volume x: type hostPath",)
    number, text = proposed(world, {PATH: application(description="Changed by hand")})
    assert not world.merged(number)
    assert "it cannot be merged." in text
    assert "applications/relaying.yaml: spec.services[0]: Deployment relay: volume x: type hostPath" in text
    assert on_main(world).assured


def test_nobody_writes_a_statement_by_hand_and_who_takes_it_away_takes_its_evidence(world: PublicationStage) -> None:
    published(world)
    number, text = proposed(world, {PATH: application(description="Changed"), STATEMENT: world.main()[STATEMENT] + " "})
    assert not world.merged(number)
    assert f"{STATEMENT}: the gate alone writes this file" in text
    number, _ = proposed(world, {STATEMENT: None})
    assert world.merged(number)
    assert on_main(world).evidence == ""


def test_a_withdrawal_tries_nothing(world: PublicationStage) -> None:
    published(world)
    asked = len(world.trials.asked)
    path = "charts/relay/0.1.0.yaml"
    number, _ = proposed(world, {path: world.main()[path].replace("state: verified", "state: withdrawn")})
    assert world.merged(number)
    assert len(world.trials.asked) == asked
    assert on_main(world).assured
