"""The publication loop while other things move: main, the pull request, the gate's own end at every point."""

from pathlib import Path

import pytest

from robotkube.registry.evidence.core.statements import Check
from robotkube.registry.suites.core.requests import SuiteProgress
from tests.stages.registry.publication_in_memory import PublicationStage, assured, status_of
from tests.stages.registry.submissions import SUITES, chart, entry, entry_path


class KilledError(BaseException):
    """The process ends here; nothing catches it."""


@pytest.fixture
def world(tmp_path: Path) -> PublicationStage:
    return PublicationStage(tmp_path)


def test_a_pull_request_that_changes_while_suites_run_is_decided_anew(world: PublicationStage) -> None:
    first, second = chart(), chart(text="kind: Secret\n")
    world.runner.progress["install"] = SuiteProgress("running")
    number = world.submit(first)
    world.gate.round()
    commit = world.catalogue.commit(world.catalogue.tip, {entry_path(second[0]): entry(*second)}, "other")
    world.registry.push_chart("staging-publisher", second[0], "other")
    world.forge.update(number, commit)
    del world.runner.progress["install"]
    world.runner.checks["install"] = (Check("installs", False, "no", "yes"),)
    world.settle(number)
    assert not world.merged(number)
    assert entry_path(second[0]) not in world.main()


def test_a_head_that_changes_at_the_last_moment_is_not_on_main_unchecked(world: PublicationStage) -> None:
    first = chart()
    number = world.submit(first)
    evil = world.catalogue.commit(world.catalogue.tip, {"charts/evil/0.1.0.yaml": "x"}, "evil")

    def swap() -> None:
        world.catalogue.before_push = lambda: None
        world.forge.update(number, evil)

    world.catalogue.before_push = swap
    text = world.settle(number)
    assert status_of(world, first[0])["state"] == "verified"
    assert "charts/evil/0.1.0.yaml" not in world.main()
    assert not world.merged(number)
    assert "## Refused" in text


def test_main_that_moves_before_the_push_is_looked_at_again(world: PublicationStage) -> None:
    number = world.submit(chart())

    def move() -> None:
        world.catalogue.before_push = lambda: None
        world.catalogue.push({"README.md": "a person was here\n"})

    world.catalogue.before_push = move
    world.settle(number)
    assert world.merged(number)
    assert world.main()["README.md"] == "a person was here\n"
    assert len(world.runner.runs) == len(SUITES)


def test_a_version_published_meanwhile_with_another_digest_is_not_replaced(world: PublicationStage) -> None:
    first, second = chart(), chart(text="kind: Secret\n")
    one, two = world.submit(first), world.submit(second)
    world.settle(one)
    assert "a version is never replaced: raise" in world.settle(two)
    assert status_of(world, first[0])["digest"] == first[0].digest


@pytest.mark.parametrize(("method", "call"), [("attach", 1), ("attach", 2), ("attach", 5), ("copy_chart", 1)])
def test_a_gate_killed_between_sign_attach_and_copy_is_finished_by_the_next(
    world: PublicationStage, method: str, call: int
) -> None:
    packed = chart()
    number = world.submit(packed)
    calls = {"attach": 0, "copy_chart": 0}

    def kill(name: str) -> None:
        calls[name] += 1
        if name == method and calls[name] == call:
            raise KilledError

    world.registry.before = kill
    with pytest.raises(KilledError):
        world.settle(number)
    assert entry_path(packed[0]) not in world.main()
    world.registry.before = lambda name: None
    world.start()
    world.settle(number)
    assert world.merged(number)
    assert assured(world, packed[0])


def test_a_gate_killed_before_the_merge_is_finished_by_the_next(world: PublicationStage) -> None:
    packed = chart()
    number = world.submit(packed)

    def kill() -> None:
        raise KilledError

    world.catalogue.before_push = kill
    with pytest.raises(KilledError):
        world.settle(number)
    assert entry_path(packed[0]) not in world.main()
    copied = list(world.registry.attachments("verified/relay", packed[0].digest))
    assert len(copied) == len(SUITES) + 1
    world.catalogue.before_push = lambda: None
    world.start()
    world.settle(number)
    assert world.merged(number)
    assert list(world.registry.attachments("verified/relay", packed[0].digest)) == copied
    assert len(world.forge.said[number]) == 1


def test_a_gate_killed_after_the_merge_leaves_it(world: PublicationStage) -> None:
    number = world.submit(chart())
    world.settle(number)
    tip = world.catalogue.tip
    world.forge.pulls[number] = world.forge.pulls[number].__class__(
        **{**vars(world.forge.pulls[number]), "state": "open", "merged": False}
    )
    world.start().round()
    assert world.catalogue.tip == tip
    assert len(world.forge.said[number]) == 1
