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
def world(tmp_path: Path) -> PublicationStage:
    return PublicationStage(tmp_path)


def waiting(world: PublicationStage) -> int:
    """A submission whose suites have passed, and which waits."""
    number = world.submit(chart(), **{PATH: INITIAL})
    for _ in range(10):
        world.gate.round()
    assert world.forge.pulls[number].state == "open"
    text = world.text(number)
    assert "## Waiting: relay 0.1.0, application relaying" in text
    assert "runs by itself on every agent of role cloud (initialFor). Somebody with write rights who is no" in text
    assert PATH not in world.main()
    return number


def test_it_waits_and_is_published_with_a_persons_approval(world: PublicationStage) -> None:
    number = waiting(world)
    shown("gate", world.text(number), "runs-by-itself")
    world.forge.reviewed[number] = [Review("reviewer", world.forge.pulls[number].head, True, True)]
    assert "## Verified: relay 0.1.0" in world.settle(number)
    assert world.merged(number)
    assert world.main()[PATH] == INITIAL
    publication = world.catalogue.commits[world.catalogue.tip]
    assert publication.message.endswith(f"RobotKube-Pull-Request: {number}\nRobotKube-Approved-By: reviewer\n")
    assert publication.author == "publisher"


@pytest.mark.parametrize("account", ["publisher", "gate"])
def test_no_machine_approves(world: PublicationStage, account: str) -> None:
    number = waiting(world)
    world.forge.reviewed[number] = [Review(account, world.forge.pulls[number].head, True, True)]
    world.gate.round()
    assert world.forge.pulls[number].state == "open"
    assert PATH not in world.main()


def test_an_approval_is_of_one_commit(world: PublicationStage) -> None:
    world.settle(world.submit(chart()))
    number = world.submit(**{PATH: INITIAL})
    old = world.forge.pulls[number].head
    other = application(initialFor="vehicle")
    world.forge.update(number, world.catalogue.commit(world.catalogue.tip, {PATH: other}, "another"))
    world.forge.reviewed[number] = [Review("reviewer", old, True, True)]
    for _ in range(3):
        world.gate.round()
    assert PATH not in world.main()
    world.forge.reviewed[number].append(Review("reviewer", world.forge.pulls[number].head, True, True))
    world.settle(number)
    assert world.main()[PATH] == other


def test_who_is_against_it_holds_it(world: PublicationStage) -> None:
    number = waiting(world)
    head = world.forge.pulls[number].head
    against = Review("other", head, False, True)
    world.forge.reviewed[number] = [Review("reviewer", head, True, True), against]
    world.gate.round()
    assert PATH not in world.main()
    world.forge.reviewed[number].append(replace(against, approved=True))
    world.settle(number)
    assert world.merged(number)


def test_a_gate_that_starts_anew_still_waits(world: PublicationStage) -> None:
    number = waiting(world)
    world.start()
    for _ in range(10):
        world.gate.round()
    assert world.forge.pulls[number].state == "open"
    assert PATH not in world.main()
