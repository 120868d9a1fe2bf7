"""What runs by itself is published when a person approved it: not its author, not a publisher, not another commit."""

from dataclasses import replace
from pathlib import Path

import pytest

from robotkube.foundation.forge.core.reviews import Review
from robotkube.registry.publication.core.approvals import approval_reasons
from tests.stages.attacks import shown
from tests.stages.registry.publication_in_memory import PublicationStage
from tests.stages.registry.submissions import application, chart

PATH = "applications/relaying.yaml"
INITIAL = application(initialFor="cloud")
REASON = f"{PATH} runs by itself on every agent of role cloud (initialFor)"
ON_MAIN = {"policies/release.yaml": "assurance: verified\n"}


def test_what_waits_is_what_runs_by_itself_and_is_new_or_changed() -> None:
    assert approval_reasons({PATH: INITIAL}, ON_MAIN) == (REASON,)
    assert approval_reasons({PATH: INITIAL}, {**ON_MAIN, PATH: application()}) == (REASON,)
    assert approval_reasons({PATH: INITIAL}, {**ON_MAIN, PATH: application(initialFor="cloud", description="y")}) != ()
    assert approval_reasons({PATH: INITIAL}, {**ON_MAIN, PATH: INITIAL}) == ()
    assert approval_reasons({PATH: application()}, {**ON_MAIN, PATH: INITIAL}) == ()
    assert approval_reasons({}, ON_MAIN) == ()


@pytest.mark.parametrize(
    ("policy", "waits"),
    [
        ("assurance: verified\n", True),
        ("assurance: verified\ninitialFor: person\n", True),
        ("assurance: verified\ninitialFor: automatic\n", False),
        ("assurance: [\n", True),
        ("", True),
        (None, True),
    ],
)
def test_only_mains_policy_opens_it(policy: str | None, waits: bool) -> None:
    main = {} if policy is None else {"policies/release.yaml": policy}
    assert bool(approval_reasons({PATH: INITIAL}, main)) is waits


@pytest.fixture
def stage(tmp_path: Path) -> PublicationStage:
    return PublicationStage(tmp_path)


def waiting(stage: PublicationStage) -> int:
    """A submission whose suites have passed, and which waits."""
    number = stage.submit(chart(), **{PATH: INITIAL})
    for _ in range(10):
        stage.gate.round()
    assert stage.forge.pulls[number].state == "open"
    text = stage.text(number)
    assert "## Waiting: relay 0.1.0, application relaying" in text
    assert "runs by itself on every agent of role cloud (initialFor). Somebody with write rights who is no" in text
    assert PATH not in stage.main()
    return number


def test_it_waits_and_is_published_with_a_persons_approval(stage: PublicationStage) -> None:
    number = waiting(stage)
    shown("gate", stage.text(number), "runs-by-itself")
    stage.forge.reviewed[number] = [Review("reviewer", stage.forge.pulls[number].head, True, True)]
    assert "## Verified: relay 0.1.0" in stage.settle(number)
    assert stage.merged(number)
    assert stage.main()[PATH] == INITIAL
    publication = stage.catalogue.commits[stage.catalogue.tip]
    assert publication.message.endswith(f"RobotKube-Pull-Request: {number}\nRobotKube-Approved-By: reviewer\n")
    assert publication.author == "publisher"


@pytest.mark.parametrize("account", ["publisher", "gate"])
def test_no_machine_approves(stage: PublicationStage, account: str) -> None:
    number = waiting(stage)
    stage.forge.reviewed[number] = [Review(account, stage.forge.pulls[number].head, True, True)]
    stage.gate.round()
    assert stage.forge.pulls[number].state == "open"
    assert PATH not in stage.main()


def test_an_approval_is_of_one_commit(stage: PublicationStage) -> None:
    stage.settle(stage.submit(chart()))
    number = stage.submit(**{PATH: INITIAL})
    old = stage.forge.pulls[number].head
    other = application(initialFor="vehicle")
    stage.forge.update(number, stage.catalogue.commit(stage.catalogue.tip, {PATH: other}, "another"))
    stage.forge.reviewed[number] = [Review("reviewer", old, True, True)]
    for _ in range(3):
        stage.gate.round()
    assert PATH not in stage.main()
    stage.forge.reviewed[number].append(Review("reviewer", stage.forge.pulls[number].head, True, True))
    stage.settle(number)
    assert stage.main()[PATH] == other


def test_who_is_against_it_holds_it(stage: PublicationStage) -> None:
    number = waiting(stage)
    head = stage.forge.pulls[number].head
    against = Review("other", head, False, True)
    stage.forge.reviewed[number] = [Review("reviewer", head, True, True), against]
    stage.gate.round()
    assert PATH not in stage.main()
    stage.forge.reviewed[number].append(replace(against, approved=True))
    stage.settle(number)
    assert stage.merged(number)


def test_a_gate_that_starts_anew_still_waits(stage: PublicationStage) -> None:
    number = waiting(stage)
    stage.start()
    for _ in range(10):
        stage.gate.round()
    assert stage.forge.pulls[number].state == "open"
    assert PATH not in stage.main()
